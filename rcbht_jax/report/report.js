"use strict";
const byId = id => document.getElementById(id);
const facts = JSON.parse(byId("facts").textContent);
const { axes, units, layers, names, meanings, colors, dt } = facts;
const LINES = ["#b35806", "#1b7837", "#2166ac", "#762a83", "#b2182b", "#35978f"];
const RED = "#b2182b", LEFT = Math.max(52, ...axes.concat(units).map(name => Math.min(180, 12 + 7 * name.length))), RIGHT = 8;
const plot = byId("plot");

// What is shown: one trial, a span of time, one axis or all (-1), and the word that is spoken about.
const view = { number: -1, trial: null, from: 0, to: 1, axis: -1, lane: [2, 0], word: -1, drag: null };
const decoded = new Map();

async function inflate(text) {
  const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(stream).arrayBuffer();
}

function summed(values) {
  for (let i = 1; i < values.length; i++) values[i] += values[i - 1];
  return values;
}

async function trialOf(number) {
  if (decoded.has(number)) return decoded.get(number);
  const about = facts.trials[number], buffer = await inflate(byId("blob-" + number).textContent), n = about.samples;
  let at = 0;
  const take = (Kind, count) => { const part = new Kind(buffer, at, count); at += part.byteLength; return part; };
  const packed = about.words.map(counts => {
    const all = counts.reduce((a, b) => a + b, 0);
    if (!all) return null;
    return { t0: summed(take(Int32Array, all)), t1: summed(take(Int32Array, all)), emit: take(Int32Array, all),
      vmax: take(Float32Array, all), vmin: take(Float32Array, all), avg: take(Float32Array, all), grad: take(Float32Array, all) };
  });
  const samples = about.beliefs.map(b => summed(take(Int32Array, b.steps)));
  const differences = take(Uint16Array, axes.length * n);
  packed.forEach((layer, l) => { if (layer) layer.code = take(Uint8Array, layer.t0.length); });
  const beliefs = about.beliefs.map((b, i) => ({ ...b, sample: samples[i], p: take(Uint8Array, b.steps * b.classes.length) }));
  const wrench = axes.map((_, a) => {
    const values = new Float32Array(n);
    for (let i = 0, code = 0; i < n; i++) {
      code = (code + differences[a * n + i]) & 0xffff;
      values[i] = about.low[a] + about.step[a] * code;
    }
    return values;
  });
  const words = about.words.map((counts, l) => {
    let start = 0;
    return counts.map(count => {
      const lane = [];
      for (let i = start; i < start + count; i++) {
        const word = {};
        for (const field of ["t0", "t1", "emit", "vmax", "vmin", "avg", "grad", "code"]) word[field] = packed[l][field][i];
        lane.push(word);
      }
      start += count;
      return lane;
    });
  });
  const trial = { about, wrench, words, beliefs, seconds: n * dt };
  decoded.set(number, trial);
  return trial;
}

async function show(number) {
  number = Math.max(0, Math.min(facts.trials.length - 1, number));
  view.number = number;
  const trial = await trialOf(number);
  if (view.number !== number) return; // another one was asked for meanwhile
  Object.assign(view, { trial, from: 0, to: trial.seconds, word: -1, drag: null });
  byId("trial").value = number;
  const a = trial.about, what = [a.source, a.session && `session ${a.session}`, a.facts, a.arm_title, `${trial.seconds.toFixed(2)} s`];
  byId("about").textContent = `${a.trial}: ${what.filter(Boolean).join(", ")}`; // an arm alone has no name
  byId("word").textContent = "Point at a word, or move from word to word with the arrow keys.";
  byId("previous").disabled = number === 0;
  byId("description").replaceChildren(...a.description.map(([time, text]) => {
    const row = document.createElement("li"), go = document.createElement("button");
    go.type = "button";
    go.textContent = `${time.toFixed(2)} s`;
    go.addEventListener("click", () => look(time - 1, time + 3));
    row.append(go, ` ${text}`);
    return row;
  }));
  byId("next").disabled = number === facts.trials.length - 1;
  draw();
}

// ---- words ----

const unitOf = a => units[a] && " " + units[a];

function say(l, a, index) {
  view.lane = [l, a];
  view.word = index;
  const word = view.trial.words[l][a][index], layer = layers[l], unit = unitOf(a), t = n => (n * dt).toFixed(3);
  const known = word.emit < 0 ? "" : `, known at ${t(word.emit)} s`;
  byId("word").textContent = `${axes[a]} ${layer}: ${names[layer][word.code]} (${meanings[layer][word.code]}), ` +
    `${t(word.t0)} to ${t(word.t1)} s${known}; mean ${word.avg.toPrecision(3)}${unit}, slope ${word.grad.toPrecision(3)}${unit || " 1"}/s, ` +
    `lines from ${word.vmin.toPrecision(3)} to ${word.vmax.toPrecision(3)}${unit}.` + believed(word.t1 * dt);
  byId("word").style.borderLeftColor = colors[layer][word.code];
  byId("layer").value = l;
  requestAnimationFrame(draw);
}

function wordAt(x, y) {
  const { signal, band, gap } = sizes(), row = signal + 3 * band + gap, shown = shownAxes(), width = plot.clientWidth;
  const place = Math.floor((y - TOP) / row), inside = (y - TOP) - place * row;
  if (place < 0 || place >= shown.length || x < LEFT || x > width - RIGHT) return null;
  const l = inside < signal ? 0 : Math.floor((inside - signal) / band), sample = tOf(x, width) / dt;
  if (l > 2) return null;
  const index = view.trial.words[l][shown[place]].findIndex(word => word.t0 <= sample && sample < word.t1);
  return index < 0 ? null : [l, shown[place], index];
}

function listWords() {
  const l = byId("layer").value * 1, a = view.axis < 0 ? view.lane[1] : view.axis, layer = layers[l], list = byId("list");
  if (!list.closest("details").open) return;
  const found = inView(l, a);
  byId("caption").textContent = `${axes[a]} ${layer}: ${found.length} word${found.length === 1 ? "" : "s"} between ${view.from.toFixed(2)} and ${view.to.toFixed(2)} s` +
    (found.length > 300 ? "; the first 300 are listed" : "") + (units[a] ? `; means in ${units[a]}, slopes in ${units[a]}/s` : "") + "; smallest and largest of the fitted lines";
  list.replaceChildren(...found.slice(0, 300).map(word => {
    const line = document.createElement("tr"), t = n => (n * dt).toFixed(3), n = v => v.toPrecision(3);
    const texts = [`${names[layer][word.code]} (${meanings[layer][word.code]})`, t(word.t0), t(word.t1), word.emit < 0 ? "" : t(word.emit),
      n(word.avg), n(word.grad), n(word.vmin), n(word.vmax)];
    line.append(...texts.map(text => { const cell = document.createElement("td"); cell.textContent = text; return cell; }));
    return line;
  }));
}

// ---- moving about ----

function look(from, to) {
  const whole = view.trial.seconds, span = Math.min(whole, Math.max(20 * dt, to - from));
  view.from = Math.max(0, Math.min(from, whole - span));
  view.to = view.from + span;
  requestAnimationFrame(draw);
}

const move = share => look(view.from + share * (view.to - view.from), view.to + share * (view.to - view.from));

function middle() { // of the chosen word if it is in view, else of the view
  const word = view.trial.words[view.lane[0]][view.lane[1]][view.word], seconds = word ? (word.t0 + word.t1) / 2 * dt : -1;
  return view.from < seconds && seconds < view.to ? seconds : (view.from + view.to) / 2;
}

function zoom(factor, centre = middle()) {
  look(centre - (centre - view.from) * factor, centre + (view.to - centre) * factor);
}

function step(by) {
  const [l, a] = view.lane, words = view.trial.words[l][a];
  if (!words.length) return;
  let index = view.word + by;
  if (view.word < 0) index = words.findIndex(word => word.t1 * dt > view.from);
  index = Math.max(0, Math.min(words.length - 1, index));
  say(l, a, index);
  const seconds = (words[index].t0 + words[index].t1) / 2 * dt, half = (view.to - view.from) / 2;
  if (seconds < view.from || seconds > view.to) look(seconds - half, seconds + half);
}

function changeLane(by) {
  const shown = shownAxes(), old = view.trial.words[view.lane[0]][view.lane[1]][view.word];
  const lane = Math.max(0, Math.min(3 * shown.length - 1, 3 * Math.max(0, shown.indexOf(view.lane[1])) + view.lane[0] + by));
  const l = lane % 3, a = shown[Math.floor(lane / 3)], words = view.trial.words[l][a];
  if (!words.length) return;
  const sample = old ? (old.t0 + old.t1) / 2 : view.from / dt, index = words.findIndex(word => word.t1 > sample);
  say(l, a, index < 0 ? words.length - 1 : index);
}

const KEYS = {
  ArrowLeft: () => step(-1), ArrowRight: () => step(1), ArrowUp: () => changeLane(-1), ArrowDown: () => changeLane(1),
  "+": () => zoom(.5), "=": () => zoom(.5), "-": () => zoom(2), ",": () => move(-.5), ".": () => move(.5),
  0: () => look(0, view.trial.seconds), n: () => show(view.number + 1), p: () => show(view.number - 1),
};

plot.addEventListener("keydown", event => {
  const act = KEYS[event.key] || KEYS[event.key.toLowerCase()];
  if (!act || !view.trial || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  act();
});

const fingers = new Map();
plot.addEventListener("pointerdown", event => {
  fingers.set(event.pointerId, event.offsetX);
  view.drag = { x: event.offsetX, now: event.offsetX, from: view.from, to: view.to, select: event.pointerType === "mouse", moved: false };
  plot.setPointerCapture(event.pointerId);
});
plot.addEventListener("pointermove", event => {
  if (!view.trial) return;
  if (!view.drag) {
    const found = wordAt(event.offsetX, event.offsetY);
    if (found && (found[2] !== view.word || found[0] !== view.lane[0] || found[1] !== view.lane[1])) say(...found);
    return;
  }
  const before = [...fingers.values()], drag = view.drag, scale = (drag.to - drag.from) / (plot.clientWidth - LEFT - RIGHT);
  fingers.set(event.pointerId, event.offsetX);
  const after = [...fingers.values()];
  drag.now = event.offsetX;
  drag.moved ||= Math.abs(drag.now - drag.x) > 4;
  if (after.length === 2) {
    const ratio = Math.max(20, Math.abs(before[0] - before[1])) / Math.max(20, Math.abs(after[0] - after[1]));
    zoom(ratio, tOf((after[0] + after[1]) / 2, plot.clientWidth));
  } else if (drag.select) requestAnimationFrame(draw);
  else if (drag.moved) look(drag.from - (drag.now - drag.x) * scale, drag.to - (drag.now - drag.x) * scale);
});
function release(event) {
  const drag = view.drag, width = plot.clientWidth;
  fingers.delete(event.pointerId);
  view.drag = null;
  if (!drag || !view.trial) return;
  if (drag.select && drag.moved) {
    const [a, b] = [drag.x, drag.now].map(x => tOf(x, width)).sort((p, q) => p - q);
    look(Math.max(0, a), Math.min(view.trial.seconds, b));
  } else if (!drag.moved) {
    const found = wordAt(event.offsetX, event.offsetY);
    if (found) say(...found);
  }
}
plot.addEventListener("pointerup", release);
plot.addEventListener("pointercancel", event => { fingers.delete(event.pointerId); view.drag = null; });
plot.addEventListener("dblclick", () => look(0, view.trial.seconds));
plot.addEventListener("wheel", event => {
  if (!event.ctrlKey) return; // plain scrolling belongs to the page
  event.preventDefault();
  zoom(event.deltaY > 0 ? 1.25 : .8, tOf(event.offsetX, plot.clientWidth));
}, { passive: false });

for (const [id, act] of Object.entries({ left: () => move(-.5), right: () => move(.5), in: () => zoom(.5), out: () => zoom(2),
  all: () => look(0, view.trial.seconds), previous: () => show(view.number - 1), next: () => show(view.number + 1) }))
  byId(id).addEventListener("click", act);
byId("trial").addEventListener("change", event => show(event.target.value * 1));
byId("axis").addEventListener("change", event => {
  view.axis = event.target.value * 1;
  if (view.axis >= 0) { view.lane = [view.lane[0], view.axis]; view.word = -1; }
  draw();
});
byId("layer").addEventListener("change", event => { view.lane = [event.target.value * 1, view.lane[1]]; view.word = -1; draw(); });
byId("list").closest("details").addEventListener("toggle", draw);
window.addEventListener("resize", () => requestAnimationFrame(draw));
window.addEventListener("beforeprint", () => { view.printing = true; draw(); });
window.addEventListener("afterprint", () => { view.printing = false; draw(); });

let box = null;
facts.trials.forEach((trial, number) => {
  const title = `${trial.source}, ${trial.outcome}`;
  if (!box || box.label !== title) { box = document.createElement("optgroup"); box.label = title; byId("trial").append(box); }
  box.append(new Option(trial.arm_title ? `${trial.trial} (${trial.arm})` : trial.trial, number));
});
byId("axis").append(new Option("all", -1), ...axes.map((name, a) => new Option(name, a)));
byId("layer").append(...layers.map((name, l) => new Option(name, l)));
byId("layer").value = 2;
byId("legend").replaceChildren(...layers.map(layer => {
  const line = document.createElement("div");
  line.append(layer + ": ", ...names[layer].slice(1).map((name, i) => {
    const key = document.createElement("span"), chip = document.createElement("i");
    chip.style.background = colors[layer][i + 1];
    key.append(chip, `${name} ${meanings[layer][i + 1]}`);
    return key;
  }));
  return line;
}));
show(0).then(() => { document.body.dataset.ready = "yes"; });
