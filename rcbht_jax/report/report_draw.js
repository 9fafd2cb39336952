// Drawing of the trial in view; stands in the same script as report.js, which holds the state.

const shownAxes = () => view.axis < 0 ? axes.map((_, a) => a) : [view.axis];
const sizes = () => view.axis < 0 ? { signal: 78, band: 13, gap: 12 } : { signal: 300, band: 30, gap: 16 };
const TOP = 34;
const xOf = (t, width) => LEFT + (width - LEFT - RIGHT) * (t - view.from) / (view.to - view.from);
const brief = value => { const text = value.toPrecision(3); return text.length > 8 ? value.toExponential(1) : text; };
const tOf = (x, width) => view.from + (view.to - view.from) * (x - LEFT) / (width - LEFT - RIGHT);

function prepare(canvas, height) {
  const ratio = Math.max(window.devicePixelRatio || 1, view.printing ? 3 : 1), width = canvas.clientWidth;
  canvas.style.height = height + "px";
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.font = "12px system-ui, sans-serif";
  pen.fillStyle = "#fff";
  pen.fillRect(0, 0, width, height);
  return [pen, width];
}

function draw() {
  if (!view.trial) return;
  const { signal, band, gap } = sizes(), row = signal + 3 * band + gap, shown = shownAxes();
  const height = TOP + shown.length * row + 24, [pen, width] = prepare(plot, height);
  shown.forEach((a, place) => {
    const top = TOP + place * row;
    drawSignal(pen, width, a, top, signal);
    layers.forEach((_, l) => drawBand(pen, width, l, a, top + signal + l * band, band));
  });
  drawMarks(pen, width, height);
  drawTime(pen, width, height);
  if (view.drag && view.drag.select) {
    pen.fillStyle = "rgba(8, 81, 156, .18)";
    pen.fillRect(Math.min(view.drag.x, view.drag.now), TOP, Math.abs(view.drag.now - view.drag.x), height - TOP - 24);
  }
  drawBeliefs();
  listWords();
  const a = view.trial.about;
  plot.setAttribute("aria-label", `${a.trial}, ${view.from.toFixed(2)} to ${view.to.toFixed(2)} s of ${view.trial.seconds.toFixed(2)} s, ` +
    (view.axis < 0 ? "all axes" : axes[view.axis]));
}

function drawSignal(pen, width, a, top, height) {
  const values = view.trial.wrench[a], first = Math.max(0, Math.floor(view.from / dt) - 1);
  const last = Math.min(values.length, Math.ceil(view.to / dt) + 2);
  let low = Infinity, high = -Infinity;
  for (let i = first; i < last; i++) { low = Math.min(low, values[i]); high = Math.max(high, values[i]); }
  if (high - low < 4 * view.trial.about.step[a]) { // flat, but for rounding
    const half = Math.max(5e-4, .05 * Math.abs(high));
    high += half;
    low -= half;
  }
  const y = v => top + height - 4 - (height - 8) * (v - low) / (high - low);
  pen.save();
  pen.beginPath();
  pen.rect(LEFT, top, width - LEFT - RIGHT, height);
  pen.fillStyle = "#fafafa";
  pen.fill();
  pen.clip();
  pen.strokeStyle = LINES[a % LINES.length];
  pen.lineWidth = 1.2;
  pen.beginPath();
  const per = Math.max(1, (last - first) / (2 * (width - LEFT - RIGHT)));
  if (per <= 2) for (let i = first; i < last; i++) pen.lineTo(xOf(i * dt, width), y(values[i]));
  else for (let s = first; s < last; s += per) { // smallest and largest of what falls on half a pixel
    let small = Infinity, large = -Infinity;
    for (let i = Math.floor(s); i < Math.min(last, s + per); i++) { small = Math.min(small, values[i]); large = Math.max(large, values[i]); }
    pen.lineTo(xOf(s * dt, width), y(small));
    pen.lineTo(xOf(s * dt, width), y(large));
  }
  if (values.length === 1) pen.arc(xOf(0, width), y(values[0]), 3, 0, 2 * Math.PI); // of which there is no line
  pen.stroke();
  pen.strokeStyle = "rgba(0, 0, 0, .75)";
  pen.lineWidth = 1;
  pen.beginPath();
  for (const word of inView(0, a)) { // the fitted lines: through the mean at the middle of the span
    const t0 = word.t0 * dt, t1 = (word.t1 - 1) * dt, half = word.grad * (t1 - t0) / 2;
    pen.moveTo(xOf(t0, width), y(word.avg - half));
    pen.lineTo(xOf(t1, width), y(word.avg + half));
  }
  pen.stroke();
  pen.restore();
  pen.fillStyle = "#222";
  pen.textAlign = "right";
  pen.fillText(axes[a], LEFT - 4, top + height / 2 + 1);
  pen.fillStyle = "#555";
  pen.font = "10px system-ui, sans-serif";
  pen.fillText(units[a], LEFT - 4, top + height / 2 + 14);
  pen.fillText(brief(high), LEFT - 4, top + 10);
  pen.fillText(brief(low), LEFT - 4, top + height - 2);
  pen.textAlign = "left";
  pen.font = "12px system-ui, sans-serif";
}

function inView(l, a) {
  return view.trial.words[l][a].filter(word => word.t1 * dt > view.from && word.t0 * dt < view.to);
}

function dark(color) {
  const [r, g, b] = [1, 3, 5].map(i => parseInt(color.slice(i, i + 2), 16));
  return .299 * r + .587 * g + .114 * b < 128;
}

function drawBand(pen, width, l, a, top, height) {
  const layer = layers[l], right = width - RIGHT;
  const chosen = view.word >= 0 && view.lane[0] === l && view.lane[1] === a ? view.trial.words[l][a][view.word] : null;
  for (const word of inView(l, a)) {
    const x0 = Math.max(LEFT, xOf(word.t0 * dt, width)), x1 = Math.min(right, xOf(word.t1 * dt, width));
    pen.fillStyle = colors[layer][word.code];
    pen.fillRect(x0, top + .5, Math.max(.7, x1 - x0 - (x1 - x0 > 4 ? .7 : 0)), height - 1);
    const text = names[layer][word.code];
    if (height > 12 && x1 - x0 > 7 * text.length + 4) {
      pen.fillStyle = dark(colors[layer][word.code]) ? "#fff" : "#000";
      pen.font = height > 20 ? "13px system-ui, sans-serif" : "10px system-ui, sans-serif";
      pen.textAlign = "center";
      pen.fillText(text, (x0 + x1) / 2, top + height / 2 + 4);
    }
    if (word === chosen) {
      pen.strokeStyle = "#000";
      pen.lineWidth = 2.5;
      pen.strokeRect(x0, top + 1, Math.max(3, x1 - x0), height - 2);
    }
  }
  pen.textAlign = "right";
  pen.fillStyle = "#555";
  pen.font = "9px system-ui, sans-serif";
  pen.fillText(layer === "primitive" ? "prim." : layer, LEFT - 4, top + height / 2 + 3);
  pen.textAlign = "left";
  pen.font = "12px system-ui, sans-serif";
}

function drawMarks(pen, width, height) {
  pen.font = "11px system-ui, sans-serif";
  const ends = [];
  for (const [seconds, text, dashed] of view.trial.about.marks) {
    if (seconds < view.from || seconds > view.to) continue;
    const x = xOf(seconds, width), wide = pen.measureText(text).width, left = Math.min(x + 3, width - RIGHT - wide);
    pen.strokeStyle = pen.fillStyle = RED;
    pen.lineWidth = 1.2;
    pen.setLineDash(dashed ? [4, 3] : []);
    pen.beginPath();
    pen.moveTo(x, TOP);
    pen.lineTo(x, height - 24);
    pen.stroke();
    let line = ends.findIndex(end => end < left);
    if (line < 0) line = ends.length;
    ends[line] = left + wide + 4;
    if (line < 2) pen.fillText(text, left, TOP - 5 - 13 * line);
  }
  pen.setLineDash([]);
}

function drawTime(pen, width, height) {
  const span = view.to - view.from, rough = span / Math.max(3, width / 110), power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map(m => m * power).find(s => s >= rough), digits = Math.max(0, -Math.floor(Math.log10(step)));
  pen.fillStyle = "#222";
  pen.textAlign = "center";
  for (let t = Math.ceil(view.from / step) * step; t <= view.to; t += step) {
    const text = t.toFixed(digits);
    pen.fillText(text, Math.min(xOf(t, width), width - 1 - pen.measureText(text).width / 2), height - 8);
  }
  pen.textAlign = "left";
  pen.fillText("s", 4, height - 8);
}

function drawBeliefs() {
  const box = byId("beliefs"), beliefs = view.trial.beliefs;
  while (box.children.length > 2 * beliefs.length) box.lastChild.remove();
  beliefs.forEach((belief, i) => {
    if (box.children.length < 2 * i + 2) box.append(document.createElement("p"), document.createElement("canvas"));
    const title = box.children[2 * i], canvas = box.children[2 * i + 1], count = belief.classes.length;
    canvas.setAttribute("role", "img");
    const [pen, width] = prepare(canvas, 120), y = p => 108 - 100 * p / 255;
    title.replaceChildren(`Belief, ${belief.head}: `, ...belief.classes.map((name, c) => {
      const key = document.createElement("span");
      key.textContent = name + (c < count - 1 ? ", " : "");
      key.style.color = LINES[c % 6];
      key.style.fontWeight = "bold";
      return key;
    }));
    pen.strokeStyle = "#ddd";
    for (const p of [0, 127.5, 255]) { pen.beginPath(); pen.moveTo(LEFT, y(p)); pen.lineTo(width - RIGHT, y(p)); pen.stroke(); }
    pen.fillStyle = "#555";
    pen.textAlign = "right";
    ["0", "0.5", "1"].forEach((text, k) => pen.fillText(text, LEFT - 4, y(127.5 * k) + 4));
    pen.save();
    pen.beginPath();
    pen.rect(LEFT, 0, width - LEFT - RIGHT, 120);
    pen.clip();
    for (let c = 0; c < count; c++) {
      pen.strokeStyle = LINES[c % 6];
      pen.lineWidth = 1.8;
      pen.setLineDash(c < 6 ? [] : [5, 3]);
      pen.beginPath();
      belief.sample.forEach((sample, s) => pen.lineTo(xOf(sample * dt, width), y(belief.p[s * count + c])));
      pen.stroke();
    }
    pen.restore();
    const last = belief.p.subarray((belief.steps - 1) * count);
    canvas.setAttribute("aria-label", `belief over time, ${belief.head}; at the end ` +
      belief.classes.map((name, c) => `${name} ${(last[c] / 255).toFixed(2)}`).join(", "));
  });
}

function believed(seconds) {
  return view.trial.beliefs.map(belief => {
    let step = -1;
    while (step + 1 < belief.steps && belief.sample[step + 1] * dt <= seconds) step += 1;
    if (step < 0) return "";
    const count = belief.classes.length, p = Array.from(belief.p.subarray(step * count, (step + 1) * count)), best = p.indexOf(Math.max(...p));
    return ` ${belief.head} believed: ${belief.classes[best]} ${(p[best] / 255).toFixed(2)}.`;
  }).join("");
}
