// The charts of the live page.

const LEFT = 52, RIGHT = 10, FONT = "12px system-ui, sans-serif", SMALL = "11px system-ui, sans-serif";
const LINES = { light: ["#c2410c", "#15803d", "#1d4ed8", "#7e22ce", "#0e7490", "#92400e"], dark: ["#fb923c", "#4ade80", "#60a5fa", "#c084fc", "#22d3ee", "#facc15"] };
const CLASSES = ["#4e79a7", "#f28e2b", "#59a14f", "#b07aa1", "#e15759", "#76b7b2", "#edc948", "#9c755f", "#bab0ac", "#ff9da7"];
let theme = null;

function colors() {
  if (!theme) {
    const style = getComputedStyle(document.documentElement), read = name => style.getPropertyValue("--" + name).trim();
    const dark = matchMedia("(prefers-color-scheme: dark)").matches;
    theme = { dark, lines: LINES[dark ? "dark" : "light"] };
    for (const name of ["back", "panel", "text", "soft", "line", "grid", "accent", "good", "warn", "bad"]) theme[name] = read(name);
  }
  return theme;
}

const classColor = c => CLASSES[c % CLASSES.length];
const place = a => view.groups.flatMap(group => group.axes.indexOf(a)).find(k => k >= 0) ?? 0;
const lineColor = a => colors().lines[place(a) % 6];
const parts = color => [1, 3, 5].map(i => parseInt(color.slice(i, i + 2), 16));
const mix = (color, other, share) => "#" + parts(color).map((v, i) => Math.round(v * share + parts(other)[i] * (1 - share)).toString(16).padStart(2, "0")).join("");
const isDark = color => { const [r, g, b] = parts(color); return .299 * r + .587 * g + .114 * b < 140; };

// Colour of a word, lighter where it would vanish on a dark page, pale while it is provisional.
function wordColor(layer, code, pale) {
  const color = about.colors[layer][code], [r, g, b] = parts(color), clear = colors().dark && r + g + b < 180 ? mix(color, "#ffffff", .68) : color;
  return pale ? mix(clear, colors().back, .4) : clear;
}

function prepare(canvas, height) {
  const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth;
  canvas.style.height = height + "px";
  const dots = [Math.round(width * ratio), Math.round(height * ratio)];
  if (canvas.width !== dots[0] || canvas.height !== dots[1]) [canvas.width, canvas.height] = dots;
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.fillStyle = colors().back;
  pen.fillRect(0, 0, width, height);
  pen.font = FONT;
  return [pen, width, t => LEFT + (width - LEFT - RIGHT) * (1 - (view.to - t) / view.span)];
}

// Round steps, about so many of them.
function step(range, count) {
  const rough = Math.max(range, 1e-9) / count, power = 10 ** Math.floor(Math.log10(rough));
  return [1, 2, 5, 10].map(m => m * power).find(s => s >= rough);
}

const digits = size => Math.max(0, -Math.floor(Math.log10(size) + 1e-9));

// Ticks in seconds of the trial that they lie in: [page time, text].
function ticks(width) {
  const size = step(view.span, Math.max(3, (width - LEFT - RIGHT) / 110)), found = [], from = view.to - view.span;
  kept.trials.forEach((trial, k) => {
    const shift = trial.shift - trial.base, begin = Math.max(from, trial.start - 1e-9), end = Math.min(view.to, kept.trials[k + 1]?.start ?? Infinity);
    for (let n = Math.ceil((begin + shift) / size - 1e-9); n * size <= end + shift; n++) found.push([n * size - shift, (n * size).toFixed(digits(size))]);
  });
  return found;
}

function grid(pen, width, height, x) {
  pen.strokeStyle = colors().grid;
  pen.lineWidth = 1;
  pen.beginPath();
  for (const [t] of ticks(width)) { pen.moveTo(x(t), 0); pen.lineTo(x(t), height); }
  pen.stroke();
}

function clip(pen, width, height) {
  pen.save();
  pen.beginPath();
  pen.rect(LEFT, 0, width - LEFT - RIGHT, height);
  pen.clip();
}

// Sub-tasks, alarms, notices and the cursor; with their names where there is room for them.
function marks(pen, width, height, x, named) {
  clip(pen, width, height);
  pen.font = SMALL;
  const free = [-Infinity, -Infinity]; // where the last name of either row ends
  for (const mark of kept.marks.slice(lower(kept.marks, view.to - view.span, one => one.t))) {
    if (mark.t > view.to) break;
    const at = x(mark.t);
    pen.strokeStyle = pen.fillStyle = colors()[mark.kind || "accent"];
    pen.setLineDash(mark.kind === "warn" && !mark.small ? [2, 3] : []);
    if (named || !mark.small) line(pen, at, mark.small ? height - 5 : 0, at, height);
    const row = free.findIndex(end => at > end);
    if (named && !mark.small && row >= 0) {
      pen.fillText(mark.text, at + 3, height - 5 - 12 * row);
      free[row] = at + pen.measureText(mark.text).width + 8;
    }
  }
  pen.setLineDash([6, 4]);
  pen.strokeStyle = colors().soft;
  for (const trial of kept.trials.slice(1)) line(pen, x(trial.start), 0, x(trial.start), height);
  pen.setLineDash([]);
  if (view.cursor !== null) {
    pen.strokeStyle = colors().text;
    line(pen, x(view.cursor), 0, x(view.cursor), height);
  }
  pen.restore();
}

function line(pen, x0, y0, x1, y1) {
  pen.beginPath();
  pen.moveTo(x0, y0);
  pen.lineTo(x1, y1);
  pen.stroke();
}

function inView(list, of) {
  const begin = Math.max(0, lower(list, view.to - view.span, of) - 1);
  return [begin, Math.min(list.length, lower(list, view.to, of) + 1)];
}

function signal(canvas, group) {
  const { unit, axes } = group;
  const height = axes.length === about.axes.length ? 220 : 150, [pen, width, x] = prepare(canvas, height), [begin, end] = inView(kept.t);
  let low = Infinity, high = -Infinity;
  for (const a of axes) for (let i = begin; i < end; i++) { low = Math.min(low, kept.v[a][i]); high = Math.max(high, kept.v[a][i]); }
  if (!(high > low)) [low, high] = begin < end ? [low - .5, high + .5] : [0, 1];
  const size = step(high - low, 4), top = Math.ceil(high / size + .05) * size, bottom = Math.floor(low / size - .05) * size;
  group.digits = Math.max(3, digits(size) + 2);
  const y = v => 20 + (height - 26) * (top - v) / (top - bottom);
  grid(pen, width, height, x);
  pen.textAlign = "right";
  for (let n = Math.round(bottom / size); n * size <= top + size / 2; n++) {
    pen.strokeStyle = n ? colors().grid : colors().line;
    line(pen, LEFT, y(n * size), width - RIGHT, y(n * size));
    pen.fillStyle = colors().soft;
    pen.fillText(digits(size) > 4 ? (+(n * size).toPrecision(3)).toExponential() : (n * size).toFixed(digits(size)), LEFT - 5, y(n * size) + 4);
  }
  clip(pen, width, height);
  axes.forEach(a => trace(pen, a, begin, end, x, y, width));
  pen.restore();
  pen.textAlign = "left";
  let at = LEFT + 4;
  for (const word of [...axes, -1]) {
    pen.fillStyle = word < 0 ? colors().soft : lineColor(word);
    const said = word < 0 ? unit && `[${unit}]` : about.axes[word];
    pen.fillText(said, at, 13);
    at += pen.measureText(said).width + 10;
  }
  marks(pen, width, height, x, true);
}

// One axis: a line through its readings, or where they are dense the smallest and largest of each half pixel.
function trace(pen, a, begin, end, x, y, width) {
  const values = kept.v[a], time = kept.t, per = Math.floor((end - begin) / (2 * (width - LEFT - RIGHT)));
  pen.strokeStyle = lineColor(a);
  pen.lineWidth = 1.5;
  pen.beginPath();
  for (let i = begin, next; i < end; i = next) {
    let small = values[i], large = small;
    for (next = i + 1; next < Math.min(end, i + per) && time[next] - time[next - 1] <= gap(); next++) {
      small = Math.min(small, values[next]);
      large = Math.max(large, values[next]);
    }
    if (i > 0 && time[i] - time[i - 1] > gap()) pen.moveTo(x(time[i]), y(small)); else pen.lineTo(x(time[i]), y(small));
    if (large > small) pen.lineTo(x(time[i]), y(large));
  }
  pen.stroke();
}

function band(pen, lane, l, top, height, x, width, pale) {
  const layer = about.layers[l], [begin, end] = inView(lane, word => word[2]);
  for (let i = begin; i < end; i++) {
    const [code, t0, t1] = lane[i], x0 = Math.max(LEFT, x(t0)), x1 = Math.min(width - RIGHT, x(t1));
    if (x1 <= LEFT || x0 >= width - RIGHT) continue;
    const color = wordColor(layer, code, pale);
    pen.fillStyle = color;
    pen.fillRect(x0, top, Math.max(.7, x1 - x0 - (x1 - x0 > 4 ? 1 : 0)), height);
    const name = about.names[layer][code], long = `${name} ${about.meanings[layer][code]}`;
    const said = height > 14 && x1 - x0 > pen.measureText(long).width + 8 ? long : name;
    if (height < 10 || x1 - x0 < pen.measureText(said).width + 6) continue;
    pen.fillStyle = isDark(color) ? "#ffffff" : "#000000";
    pen.fillText(said, (x0 + x1) / 2, top + height / 2 + 4);
  }
}

function words() {
  const layers = layersShown(), size = layers.length > 1 ? 13 : 20, row = layers.length * size + (layers.length > 1 ? 8 : 3), height = about.axes.length * row + 2;
  const [pen, width, x] = prepare(byId("words"), height);
  grid(pen, width, height, x);
  about.axes.forEach((axis, a) => {
    layers.forEach((l, k) => {
      const top = a * row + k * size + 1;
      pen.font = size > 14 ? FONT : SMALL;
      pen.textAlign = "center";
      band(pen, kept.words[l][a], l, top, size - 1, x, width, false);
      band(pen, kept.provisional[l][a], l, top, size - 1, x, width, true);
    });
    pen.font = FONT;
    pen.textAlign = "right";
    pen.fillStyle = lineColor(a);
    pen.fillText(axis, LEFT - 5, a * row + layers.length * size / 2 + 5, LEFT - 8);
  });
  marks(pen, width, height, x, false);
}

function scale(pen, width, y, values = [0, .5, 1]) {
  pen.textAlign = "right";
  for (const p of values) {
    pen.strokeStyle = colors().grid;
    line(pen, LEFT, y(p), width - RIGHT, y(p));
    pen.fillStyle = colors().soft;
    pen.fillText(String(p), LEFT - 5, y(p) + 4);
  }
  pen.textAlign = "left";
}

// Pieces of a belief's history without gaps, thinned to one answer per pixel: lists of [x, probabilities].
function answers(of, x, width) {
  const [begin, end] = inView(of.t), every = Math.max(1, Math.floor((end - begin) / (width - LEFT - RIGHT))), pieces = [];
  for (let i = begin; i < end; i += every) {
    if (i === begin || of.t[i] - of.t[Math.max(begin, i - every)] > 4 * of.step * every) pieces.push([]);
    pieces.at(-1).push([x(of.t[i]), of.p[i]]);
  }
  return pieces;
}

function beliefs(head, classes) {
  const height = 84, [pen, width, x] = prepare(byId("belief-" + head), height), y = p => 6 + (height - 12) * (1 - p);
  clip(pen, width, height);
  for (const piece of answers(kept.beliefs[head], x, width)) {
    const below = piece.map(() => 0);
    classes.forEach((_, c) => {
      pen.fillStyle = classColor(c);
      pen.beginPath();
      piece.forEach(([at], i) => pen.lineTo(at, y(below[i])));
      for (let i = piece.length - 1; i >= 0; i--) pen.lineTo(piece[i][0], y(below[i] += piece[i][1][c]));
      pen.fill();
    });
  }
  pen.restore();
  scale(pen, width, y);
  marks(pen, width, height, x, false);
}

const alarm = (head, { class: name, level }) => exceeded("alarm-" + head, kept.beliefs[head], about.heads[head].indexOf(name), level, [0, .5, 1]);

function score() {
  byId("monitor").hidden = kept.threshold === null;
  if (kept.threshold === null) return;
  const [begin, end] = inView(kept.score.t), most = kept.score.p.slice(begin, end).reduce((top, [p]) => Math.max(top, p), 1.5 * kept.threshold);
  const size = step(most, 3), values = Array.from({ length: Math.ceil(most / size) + 1 }, (_, n) => +(n * size).toPrecision(6));
  exceeded("score", kept.score, 0, kept.threshold, values);
}

// One of the numbers of each answer, and what exceeds the level; the last value marked on the scale is its top.
function exceeded(id, of, c, level, values) {
  const height = 70, [pen, width, x] = prepare(byId(id), height), y = p => 6 + (height - 12) * (1 - p / values.at(-1));
  grid(pen, width, height, x);
  scale(pen, width, y, values);
  clip(pen, width, height);
  for (const piece of answers(of, x, width)) {
    pen.fillStyle = mix(colors().bad, colors().back, .35); // what exceeds the level
    pen.beginPath();
    pen.moveTo(piece[0][0], y(level));
    for (const [at, p] of piece) pen.lineTo(at, y(Math.max(level, p[c])));
    pen.lineTo(piece.at(-1)[0], y(level));
    pen.fill();
    pen.strokeStyle = colors().text;
    pen.lineWidth = 1.5;
    pen.beginPath();
    for (const [at, p] of piece) pen.lineTo(at, y(p[c]));
    pen.stroke();
  }
  pen.strokeStyle = colors().bad;
  pen.setLineDash([6, 4]);
  line(pen, LEFT, y(level), width - RIGHT, y(level));
  pen.restore();
  marks(pen, width, height, x, false);
}

function timeAxis() {
  const [pen, width, x] = prepare(byId("axis"), 20);
  pen.textAlign = "center";
  pen.fillStyle = colors().text;
  for (const [t, said] of ticks(width)) if (x(t) >= LEFT - 1) pen.fillText(said, Math.min(x(t), width - RIGHT - 6), 14);
  pen.textAlign = "right";
  pen.fillStyle = colors().soft;
  pen.fillText("s", LEFT - 12, 14);
}

// All that is kept, as behaviours, and the part of it in view.
function overview() {
  const canvas = byId("overview"), height = Math.max(30, 3 * about.axes.length + 8), [pen, width] = prepare(canvas, height), begin = begins(), range = kept.latest - begin;
  const x = t => LEFT + (width - LEFT - RIGHT) * (t - begin) / range, row = (height - 4) / about.axes.length, layer = about.layers[BEHAVIOURS];
  pen.fillStyle = colors().panel;
  pen.fillRect(LEFT, 0, width - LEFT - RIGHT, height);
  about.axes.forEach((_, a) => {
    let last = -1;
    for (const pale of [false, true]) for (const [code, t0, t1] of (pale ? kept.provisional : kept.words)[BEHAVIOURS][a]) {
      if (x(t1) < LEFT || x(t1) - last < .5) continue; // thinner than can be seen
      last = x(t1);
      pen.fillStyle = wordColor(layer, code, pale);
      pen.fillRect(Math.max(LEFT, x(t0)), 2 + a * row, Math.max(.7, last - Math.max(LEFT, x(t0))), row);
    }
  });
  const x0 = Math.max(LEFT, x(view.to - view.span)), x1 = Math.min(width - RIGHT, x(view.to));
  pen.fillStyle = mixed(colors().back, .65);
  pen.fillRect(LEFT, 0, x0 - LEFT, height);
  pen.fillRect(x1, 0, width - RIGHT - x1, height);
  pen.strokeStyle = colors().accent;
  pen.lineWidth = 2;
  pen.strokeRect(x0 + 1, 1, Math.max(3, x1 - x0 - 2), height - 2);
  canvas.setAttribute("aria-valuemin", begin.toFixed(1));
  canvas.setAttribute("aria-valuemax", kept.latest.toFixed(1));
  canvas.setAttribute("aria-valuenow", view.to.toFixed(1));
  canvas.setAttribute("aria-valuetext", `${ownTime(Math.max(begin, view.to - view.span)).toFixed(1)} to ${ownTime(view.to).toFixed(1)} s`);
}

const mixed = (color, alpha) => `rgba(${parts(color).join(", ")}, ${alpha})`;

function draw(now) {
  requestAnimationFrame(draw); // first, so that the page goes on whatever happens below
  if (dirty && about && kept.t.length && byId("words").clientWidth) {
    dirty = false;
    view.groups.forEach((group, k) => signal(byId("signal-" + k), group));
    words();
    for (const [head, classes] of Object.entries(about.heads)) beliefs(head, classes);
    for (const [head, level] of Object.entries(about.alarms)) alarm(head, level);
    score();
    timeAxis();
    overview();
  }
  if (about && kept.t.length) readOut(now);
}

start();
