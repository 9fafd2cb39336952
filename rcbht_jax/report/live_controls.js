// Buttons, keys and text of the live page.

const BEHAVIOURS = 2, SHORT = 0.2, LONG = KEEP; // index of the layer; limits of the zoom, s
const RULES = { fit: "fit rule", paper: "published rules" };
let shownAt = 0;

function text(tag, content, className) {
  const node = document.createElement(tag);
  node.textContent = content;
  if (className) node.className = className;
  return node;
}

function swatch(color) {
  const node = text("i", "", "swatch");
  node.style.background = color;
  return node;
}

const layersShown = () => byId("layer").value === "all" ? about.layers.map((_, l) => l) : [about.layers.indexOf(byId("layer").value)];

// Axes of the same unit share a chart, six at most.
function groups() {
  const units = new Map();
  about.units.forEach((unit, a) => units.set(unit, [...units.get(unit) ?? [], a]));
  return [...units].flatMap(([unit, axes]) =>
    Array.from({ length: Math.ceil(axes.length / 6) }, (_, k) => ({ unit, axes: axes.slice(6 * k, 6 * k + 6) })));
}

function chart(id, label) {
  const canvas = document.createElement("canvas");
  canvas.id = id;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", label);
  return canvas;
}

// Everything that depends on the axes and the classifiers of the stream.
function build() {
  view.groups = groups();
  byId("signals").replaceChildren(...view.groups.map(({ unit, axes }, k) =>
    chart("signal-" + k, `${axes.map(a => about.axes[a]).join(", ")} ${unit ? "in " + unit : ""} over time; the table has the values`)));
  byId("words").setAttribute("aria-label", "words of each axis over time; the table has them in writing");
  byId("now").tBodies[0].replaceChildren(...about.axes.map((axis, a) => {
    const row = document.createElement("tr"), name = text("th", axis);
    name.scope = "row";
    name.prepend(swatch(lineColor(a)));
    row.append(name, text("td", "–"), text("td", "–"));
    return row;
  }));
  const charts = [], bars = [];
  for (const [head, classes] of Object.entries(about.heads)) {
    charts.push(text("h2", "Belief: " + head), chart("belief-" + head, `probabilities of ${classes.join(", ")} over time, stacked; the bars have the values`));
    const alarm = about.alarms[head];
    if (alarm) charts.push(text("h2", `Alarm: ${alarm.class} above ${alarm.level.toFixed(2)}`),
      chart("alarm-" + head, `probability of ${alarm.class} over time, with the alarm level ${alarm.level.toFixed(2)}`));
    const box = text("div", "", "head"), title = text("h2", head + " ");
    box.id = "head-" + head;
    title.append(text("span", "", "level"));
    box.append(title, ...classes.map((name, c) => {
      const row = text("div", "", "row"), bar = text("div", "", "bar"), fill = document.createElement("i");
      fill.style.background = classColor(c);
      bar.append(fill);
      row.append(text("span", name), bar, text("span", ""));
      return row;
    }));
    bars.push(box);
  }
  const monitor = text("div", "");
  monitor.id = "monitor";
  monitor.hidden = true; // until a score comes
  monitor.append(text("h2", "Anomaly score"), chart("score", "anomaly score over time, with the threshold of the alarm"));
  byId("beliefs").replaceChildren(...charts, monitor);
  byId("bars").replaceChildren(...bars);
  byId("events").replaceChildren();
  listen();
  key();
  dirty = true;
}

function key() {
  byId("key").replaceChildren(...layersShown().flatMap(l => {
    const layer = about.layers[l];
    return about.names[layer].slice(1).map((name, i) => {
      const node = text("span", `${name} ${about.meanings[layer][i + 1]}`);
      node.prepend(swatch(wordColor(layer, i + 1, false)));
      return node;
    });
  }), text("span", `words by the ${RULES[about.rule]}; pale: provisional, may still change`));
  if (about.believed !== about.rule) byId("key").append(text("span", `The beliefs read other words, those by the ${RULES[about.believed]}.`));
}

function log(event, kind) {
  const rest = Object.entries(event).filter(([k, v]) => !["event", "sample", "time"].includes(k) && v !== "");
  const said = event.event === "Notice" ? `${event.kind}: ${event.text}` : `${event.event} ${rest.map(([k, v]) => k + "=" + (typeof v === "number" ? +(Math.abs(v) < 1 ? v.toPrecision(3) : v.toFixed(3)) : v)).join(" ")}`;
  const base = kept.trials.at(-1)?.base ?? 0;
  const same = event.event === "Notice" && [...byId("events").children].slice(0, 6).find(node => node.dataset.notice === event.kind);
  const count = same ? +same.dataset.count + 1 : 1; // one line for what happens again and again
  const entry = text("div", `${(event.time - base).toFixed(3)} s  ${said}${same ? ` (${count} times)` : ""}`, kind);
  if (event.event === "Notice") Object.assign(entry.dataset, { notice: event.kind, count });
  if (same) same.remove();
  byId("events").prepend(entry);
  while (byId("events").childElementCount > 200) byId("events").lastChild.remove();
}

// The state of the connection and of the stream, in words.
function tell() {
  const silence = (performance.now() - link.heard) / 1000, known = kept.t.length > 0;
  let [kind, said] = ["live", "live"];
  if (link.state === "lost") [kind, said] = ["lost", "no connection, trying again"];
  else if (link.state === "ended") [kind, said] = ["ended", "ended; waiting for the next stream"];
  else if (link.state === "waiting") [kind, said] = ["waiting", "connecting"];
  else if (link.status) [kind, said] = [known ? "ended" : "waiting", link.status];
  else if (!known) [kind, said] = ["waiting", "waiting for the first readings"];
  else if (!view.live) [kind, said] = ["paused", `paused, ${Math.max(0, kept.latest - view.to).toFixed(1)} s behind`];
  else if (silence > Math.max(1.5, 4 * about.dt)) [kind, said] = ["silent", `silent for ${Math.floor(silence)} s`];
  const state = byId("state");
  if (state.textContent !== said) state.textContent = said;
  state.dataset.kind = kind;
  byId("wait").hidden = known;
  if (!known) byId("wait").textContent = said[0].toUpperCase() + said.slice(1) + ".";
  document.querySelector("main").hidden = !known;
  byId("clock").textContent = known ? `${ownTime(kept.latest).toFixed(2)} s, ${kept.sample} samples` : "";
  const raised = [...kept.raised].map(head => "alarm: " + (about.alarms[head]?.class ?? head)).join(", "), alarm = byId("alarm");
  if (alarm.textContent !== raised) alarm.textContent = raised;
  alarm.hidden = !raised;
}

function wordAt(lane, t) {
  const place = lower(lane, t, word => word[2] - 1e-9);
  return place < lane.length && lane[place][1] <= t ? lane[place] : null;
}

// Values, words and beliefs at the cursor, else at the end of what is shown.
function readOut(now) {
  if (now - shownAt < 100) return;
  shownAt = now;
  const t = view.cursor ?? Math.min(view.to, kept.latest), place = Math.max(0, lower(kept.t, t + 1e-6) - 1), l = layersShown().at(-1), layer = about.layers[l];
  byId("moment").textContent = view.cursor === null && view.live ? "Now" : `At ${ownTime(t).toFixed(3)} s`;
  const there = kept.t.length && Math.abs(kept.t[place] - t) < gap(), at = t - 1e-6;
  [...byId("now").rows].slice(1).forEach((row, a) => {
    row.cells[1].textContent = there ? `${kept.v[a][place].toFixed(view.groups.find(group => group.axes.includes(a)).digits)} ${about.units[a]}` : "–";
    const held = kept.provisional[l][a], word = wordAt(kept.words[l][a], at);
    const other = word ?? wordAt(held, at) ?? (held.length && at >= held.at(-1)[1] ? held.at(-1) : null);
    row.cells[2].textContent = other ? `${about.names[layer][other[0]]} ${about.meanings[layer][other[0]]}` : "–";
    row.cells[2].className = other && !word ? "provisional" : "";
  });
  const scored = lower(kept.score.t, t + 1e-6) - 1;
  if (scored >= 0) byId("monitor").firstChild.textContent = `Anomaly score ${kept.score.p[scored][0].toFixed(2)}, alarm above ${kept.threshold.toFixed(2)}`;
  for (const [head, classes] of Object.entries(about.heads)) {
    const of = kept.beliefs[head], place = lower(of.t, t + 1e-6) - 1;
    const p = place < 0 ? null : of.p[place], best = p ? p.indexOf(Math.max(...p)) : -1, box = byId("head-" + head);
    const newest = p && place === of.p.length - 1;
    box.querySelector(".level").textContent = newest ? of.latest.level : "";
    box.querySelectorAll(".row").forEach((row, c) => {
      row.className = "row" + (c === best ? " best" : "");
      row.querySelector("i").style.width = (p ? 100 * p[c] : 0) + "%";
      row.lastChild.textContent = p ? p[c].toFixed(2) : "–";
    });
  }
}

function pause(live) {
  view.live = live;
  if (live) view.to = kept.latest;
  byId("pause").textContent = live ? "Pause" : "Resume";
  dirty = true;
  tell();
}

function move(to) {
  if (view.live) pause(false);
  view.to = Math.min(kept.latest, Math.max(to, Math.min(kept.latest, oldest() + view.span)));
  dirty = true;
  tell();
}

// Zoom by a factor, with the time under the cursor in its place; the newest stays in its place while live.
function zoom(factor, at = view.live ? view.to : view.to - view.span / 2) {
  const span = Math.min(LONG, Math.max(SHORT, view.span * factor)), share = (view.to - at) / view.span;
  view.span = span;
  const choice = [...byId("span").options].find(option => +option.value === span);
  byId("span").value = choice ? choice.value : "0";
  if (view.live) dirty = true;
  else move(at + share * span);
}

const timeAt = (canvas, event) => {
  const box = canvas.getBoundingClientRect();
  return view.to - view.span * (1 - (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT));
};

// Mouse and touch on the charts that build() has made.
function listen() {
  for (const canvas of document.querySelectorAll("#signals canvas, #words, #beliefs canvas")) {
    let held = null;
    canvas.onpointerdown = event => { held = { x: event.clientX, to: view.to, moved: false }; canvas.setPointerCapture(event.pointerId); };
    canvas.onpointerup = canvas.onpointercancel = () => { held = null; };
    canvas.onpointerleave = () => { view.cursor = null; dirty = true; };
    canvas.onpointermove = event => {
      if (held && (held.moved ||= Math.abs(event.clientX - held.x) > 4))
        move(held.to - view.span * (event.clientX - held.x) / (canvas.clientWidth - LEFT - RIGHT));
      const t = timeAt(canvas, event);
      view.cursor = t >= view.to - view.span && t <= view.to ? t : null;
      dirty = true;
    };
    canvas.onwheel = event => {
      const side = event.shiftKey ? event.deltaY || event.deltaX : event.deltaX;
      if (event.ctrlKey || event.altKey) zoom(1.0015 ** event.deltaY, view.live ? view.to : timeAt(canvas, event));
      else if (side) move(view.to + view.span * side / 1000);
      else return;
      event.preventDefault();
    };
  }
}

function controls() {
  byId("pause").onclick = () => pause(!view.live);
  byId("newest").onclick = () => pause(true);
  byId("closer").onclick = () => zoom(1 / 1.5);
  byId("wider").onclick = () => zoom(1.5);
  byId("span").onchange = () => zoom(byId("span").value / view.span);
  byId("layer").onchange = () => { dirty = true; if (about) key(); };
  const strip = byId("overview"), jump = event => {
    const box = strip.getBoundingClientRect(), share = (event.clientX - box.left - LEFT) / (box.width - LEFT - RIGHT);
    move(begins() + share * (kept.latest - begins()) + view.span / 2);
  };
  strip.onpointerdown = event => { strip.setPointerCapture(event.pointerId); jump(event); };
  strip.onpointermove = event => { if (event.buttons) jump(event); };
  const keys = {
    " ": () => pause(!view.live), ArrowLeft: () => move(view.to - view.span / 4), ArrowRight: () => move(view.to + view.span / 4),
    "+": () => zoom(1 / 1.5), "=": () => zoom(1 / 1.5), "-": () => zoom(1.5), Home: () => move(-Infinity), End: () => pause(true),
  };
  document.addEventListener("keydown", event => {
    const own = event.target.closest("select, summary, #events") || (event.key === " " && event.target.closest("button"));
    if (!about || own || event.ctrlKey || event.altKey || event.metaKey || !keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { theme = null; if (about) build(); });
  addEventListener("resize", () => { dirty = true; });
}
