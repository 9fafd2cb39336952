// What the page keeps of a stream, and how it gets it. The controls are in live_controls.js, the charts in live_draw.js.

const KEEP = 600, MOST = 700000, GAP = 0.3; // s kept; readings kept, ten minutes at 1 kHz and what is cut at once; s without a reading that are drawn as a gap
const byId = id => document.getElementById(id);
let about = null; // what the frames mean, see live_page.description
let kept = empty(0); // of the present stream
const view = { to: 0, span: 15, live: true, cursor: null }; // page time, s
const link = { state: "waiting", status: "", heard: 0, number: 0, tries: 0 };
let dirty = true;

function empty(axes, classes = {}) {
  const lanes = () => Array.from({ length: 3 }, () => Array.from({ length: axes }, () => []));
  const beliefs = Object.fromEntries(Object.keys(classes).map(head => [head, { t: [], p: [], step: Infinity, latest: null }]));
  return {
    t: [], v: Array.from({ length: axes }, () => []), words: lanes(), provisional: lanes(), beliefs, marks: [],
    score: { t: [], p: [], step: Infinity }, threshold: null, raised: new Set(), trials: [], latest: 0, sample: 0, stamp: 0,
  };
}

const first = () => Math.min(kept.trials.length ? kept.trials[0].start : 0, kept.t.length ? kept.t[0] : Infinity);
const since = () => Math.min(kept.latest - KEEP, view.live ? Infinity : view.to - view.span); // what is looked at stays
const oldest = () => Math.max(first(), since());
const gap = () => Math.max(GAP, 4 * about.dt);
const begins = () => Math.min(oldest(), kept.latest - view.span); // of the strip

// The first index whose value is at least x, in a list in order.
function lower(list, x, of = value => value) {
  let low = 0, high = list.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (of(list[middle]) < x) low = middle + 1; else high = middle;
  }
  return low;
}

function understand(said) {
  if (about && said.stream === about.stream) return; // the same stream after a lost connection
  about = said;
  kept = empty(about.axes.length, about.heads);
  link.number = 0;
  view.cursor = null;
  build();
  pause(true);
}

// Page time of a time stamp: stamps may be dates, and begin anew with every trial.
function trialOf(frame) {
  const last = kept.trials.at(-1);
  if (last && last.number === frame.trial) return last;
  const stamp = frame.wrench[0][0];
  const on = last && stamp > kept.stamp && stamp < kept.stamp + 60; // a gap, after which the clock went on
  const shift = on ? last.shift : last ? stamp - kept.latest - 1 : frame.base;
  kept.trials.push({ number: frame.trial, start: stamp - shift, shift, base: frame.base });
  return kept.trials.at(-1);
}

const ownTime = t => {
  const trial = kept.trials[Math.max(0, lower(kept.trials, t + 1e-9, one => one.start) - 1)];
  return trial ? t + trial.shift - trial.base : t;
};

function take(frame) {
  if (!about || frame.number <= link.number) return; // seen before the connection was lost
  const lost = link.number && frame.number - link.number - 1; // this viewer was too slow, or away for too long
  link.number = frame.number;
  link.heard = performance.now();
  kept.raised = new Set(frame.raised); // also alarms that were raised before this page was opened
  if (!frame.wrench.length && kept.trials.at(-1)?.number !== frame.trial) { // no reading of this trial has come yet
    for (const event of frame.events) note(event, kept.latest);
    return;
  }
  const { shift } = trialOf(frame);
  for (const [stamp, ...values] of frame.wrench) {
    kept.t.push(stamp - shift);
    values.forEach((value, a) => kept.v[a].push(value));
  }
  const moved = ([, , code, t0, t1]) => [code, t0 - shift, t1 - shift];
  for (const word of frame.words) kept.words[word[0]][word[1]].push(moved(word));
  for (const layer of kept.provisional) for (const lane of layer) lane.length = 0;
  for (const word of frame.provisional) kept.provisional[word[0]][word[1]].push(moved(word));
  const keep = (of, t, values) => {
    of.step = Math.min(of.step, t - (of.t.at(-1) ?? -Infinity));
    of.t.push(t);
    of.p.push(values);
  };
  for (const belief of frame.beliefs) {
    keep(kept.beliefs[belief.head], belief.time - shift, belief.probabilities);
    kept.beliefs[belief.head].latest = belief;
  }
  for (const [time, score, threshold] of frame.scores) {
    keep(kept.score, time - shift, [score]);
    kept.threshold = threshold;
  }
  if (lost) note({ event: "Notice", kind: "lost", text: `${lost} frames did not reach this page`, time: frame.time }, frame.wrench.length ? frame.wrench[0][0] - shift : kept.latest);
  for (const event of frame.events) note(event, event.time - shift);
  Object.assign(kept, { latest: frame.time - shift, stamp: frame.time, sample: frame.sample });
  forget(since());
  if (view.live) view.to = kept.latest;
  dirty = true;
}

function note(event, t) {
  const kind = { AnomalyRaised: "bad", AnomalyCleared: "good", Notice: "warn", FailureType: "bad" }[event.event] ?? "";
  const text = event.event === "SubtaskStarted" ? event.detected ? "sub-task (detected)" : event.label || "sub-task" : event.event === "Notice" ? event.kind
    : event.event === "TrialStarted" ? "trial " + event.trial
    : event.event === "AnomalyRaised" ? "alarm" : event.event === "AnomalyCleared" ? "cleared" : event.label ?? event.event;
  const small = event.event === "Notice" && !["silent", "resumed", "lost"].includes(event.kind); // often, on a real network
  kept.marks.push({ small, t: Math.max(t, kept.marks.at(-1)?.t ?? 0, kept.trials.at(-1)?.start ?? 0), kind, text });
  if (kept.marks.length > 3000) kept.marks.splice(0, 1000); // a stream of nothing but errors
  log(event, kind);
}

// Everything older goes, in large pieces, because cutting a long list is slow.
function forget(before) {
  const many = kept.t.length > MOST, cut = many ? kept.t.length - Math.round(0.9 * MOST) : lower(kept.t, before);
  if (!many && (!cut || kept.t[0] > before - 20)) return;
  const from = kept.t[cut] ?? before;
  kept.t.splice(0, cut);
  for (const values of kept.v) values.splice(0, cut);
  for (const layer of kept.words) for (const lane of layer) lane.splice(0, lower(lane, from, word => word[2]));
  for (const of of [...Object.values(kept.beliefs), kept.score]) {
    const old = lower(of.t, from);
    of.t.splice(0, old);
    of.p.splice(0, old);
  }
  kept.marks.splice(0, lower(kept.marks, from, mark => mark.t));
  kept.trials.splice(0, Math.max(0, lower(kept.trials, from, trial => trial.start) - 1));
}

function connect() {
  const source = new EventSource("frames");
  const again = state => { // a server that was restarted is found again, whatever ended the former one
    source.close();
    link.state = state;
    link.tries += 1;
    setTimeout(connect, Math.min(10000, 1000 + 500 * link.tries));
    tell();
  };
  const hear = (kind, use) => source.addEventListener(kind, message => { use(JSON.parse(message.data)); tell(); });
  hear("about", understand);
  hear("status", text => { link.status = text; });
  hear("frame", take);
  source.onopen = () => { Object.assign(link, { state: "live", tries: 0, heard: performance.now() }); tell(); };
  source.addEventListener("end", () => again("ended"));
  source.onerror = () => again(link.state === "ended" ? "ended" : "lost");
}

function start() {
  controls();
  connect();
  setInterval(tell, 250);
  requestAnimationFrame(draw);
}
