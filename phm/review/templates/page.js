
// A separate block: uPlot before it has its own names.
{
const data = JSON.parse(document.getElementById("data").textContent);
const { window: span, agents, faults, plots, other, groups, availability } = data, unitsCut = new Map(data.units_cut);
const $ = (id) => document.getElementById(id);
const element = (tag, text, kind) => { const made = document.createElement(tag); if (text !== undefined) made.textContent = text; if (kind) made.className = kind; return made; };
const pad = (n, w = 2) => String(Math.floor(n)).padStart(w, "0");
const whole = Math.max(span.duration_s, 1);
const clock = (s, digits = 0) => { const d = new Date((span.begin + s) * 1000); return isNaN(d) ? "?" : d.toISOString().slice(data.dated ? 0 : 11, digits ? 23 : 19).replace("T", " "); };
const long = (s) => s < 60 ? `${s.toFixed(1)} s` : s < 3600 ? `${Math.floor(s / 60)} min ${pad(s % 60)} s` : `${Math.floor(s / 3600)} h ${pad(s % 3600 / 60)} min`;

// ---- timeline
const canvas = $("time"), pen = canvas.getContext("2d"), tip = $("tip");
const LEFT = 150, TOP = 24, ROW = agents.length > 24 ? 17 : 24, UNIT = 14;
const HEIGHT = { ERROR: 1, WARN: 0.75, STALE: 0.45, OK: 0.55, "n/a": 0.2 };
let from = 0, to = whole, colours = {}, rows = [], marks = [];
const open = new Set();
const byAgent = new Map(agents.map((agent) => [agent.agent, []]));
faults.forEach((fault, index) => byAgent.get(fault.agent)?.push([fault.opened - span.begin, index]));

const others = new Map(agents.map((agent) => [agent.agent, []]));
for (const [s, agent, what, text, level] of other) others.get(agent)?.push([s, what, text, level]);

function layout() {
  rows = []; let y = TOP;
  for (const agent of agents) {
    rows.push({ agent, y, height: ROW, name: agent.agent, segments: agent.levels, joined: agent.joined_s }); y += ROW;
    if (!open.has(agent.agent)) continue;
    const add = (unit, segments = []) => { rows.push({ agent, unit, y, height: UNIT, name: unit, segments, joined: agent.units_joined_s }); y += UNIT; };
    for (const [unit, segments] of Object.entries(agent.units)) add(unit, segments);
    if (unitsCut.has(agent.agent)) add(`and ${unitsCut.get(agent.agent)} more`);
  }
  return y + 6;
}
const x = (s, width) => LEFT + (s - from) / (to - from) * (width - LEFT - 8);
const time = (px, width) => from + (px - LEFT) / (width - LEFT - 8) * (to - from);
function palette() { const style = getComputedStyle(document.documentElement); for (const key of ["bg", "fg", "dim", "line", "ok", "warn", "error", "stale", "off", "armed", "act"]) colours[key] = style.getPropertyValue(`--${key}`).trim(); }
const colour = (level) => colours[{ OK: "ok", WARN: "warn", ERROR: "error", STALE: "stale" }[level] || "off"];
let hatch;
function hatched() { const tile = document.createElement("canvas"); tile.width = tile.height = 6; const p = tile.getContext("2d"); p.strokeStyle = colours.off; p.lineWidth = 1.5; p.beginPath(); p.moveTo(0, 6); p.lineTo(6, 0); p.stroke(); return pen.createPattern(tile, "repeat"); }
function ticks(width) {
  const step = [1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600, 7200, 21600, 86400].find((one) => (to - from) / one <= width / (data.dated ? 180 : 130)) || (to - from) / 8;
  const first = Math.ceil((span.begin + from) / step) * step - span.begin, found = [];
  for (let s = first; s <= to; s += step) found.push(s);
  return found;
}
function draw() {
  const height = layout(), width = canvas.clientWidth, ratio = devicePixelRatio || 1;
  canvas.style.height = `${height}px`; canvas.width = width * ratio; canvas.height = height * ratio;
  pen.setTransform(ratio, 0, 0, ratio, 0, 0); pen.fillStyle = colours.bg; pen.fillRect(0, 0, width, height);
  hatch = hatched(); marks = [];
  pen.font = "12px system-ui, sans-serif"; pen.textBaseline = "middle"; pen.textAlign = "center";
  for (const s of ticks(width)) { const px = Math.round(x(s, width)) + 0.5; pen.strokeStyle = colours.line; pen.lineWidth = 1; pen.beginPath(); pen.moveTo(px, TOP - 6); pen.lineTo(px, height); pen.stroke(); pen.fillStyle = colours.dim; if (px > LEFT + 20 && px < width - 24) pen.fillText(clock(s), px, 9); }
  for (const row of rows) drawRow(row, width);
  $("range").textContent = `${clock(from)} to ${clock(to)} UTC, ${long(to - from)}`;
}
function drawRow(row, width) {
  const { y, height, agent, unit } = row, base = y + height - 4, tall = height - 8;
  pen.textAlign = "left"; pen.fillStyle = unit ? colours.dim : colours.fg; pen.font = `${unit ? 11 : 12}px system-ui, sans-serif`;
  let name = unit ? row.name : `${Object.keys(agent.units).length ? (open.has(agent.agent) ? "▾ " : "▸ ") : "  "}${row.name}${agent.logged ? "" : " (no log)"}`;
  while (pen.measureText(name).width > LEFT - 14 - (unit ? 14 : 0) && name.length > 3) name = `${name.slice(0, -2)}…`;
  pen.fillText(name, unit ? 18 : 4, y + height / 2);
  pen.save(); pen.beginPath(); pen.rect(LEFT, y, width - LEFT - 8, height); pen.clip();
  if (!unit) { pen.fillStyle = hatch; for (const [a, b] of agent.down) bar(a, b, base, tall, width); }
  for (const [a, b, level] of row.segments) {
    if (b - span.begin < from || a - span.begin > to) continue;
    const part = Math.max(2, tall * (HEIGHT[level] ?? 0.3)); pen.fillStyle = colour(level); bar(a, b, base, part, width, level === "ERROR" ? 2 : 0.6);
  }
  if (!unit) {
    pen.fillStyle = colours.armed; for (const [a, b] of agent.armed) { const left = x(a - span.begin, width); pen.fillRect(left, y + height - 3, Math.max(2, x(b - span.begin, width) - left), 3); }
    pen.strokeStyle = colours.fg; pen.lineWidth = 1.5; pen.setLineDash([4, 3]);
    for (const [a, b] of agent.link_gaps) { pen.beginPath(); pen.moveTo(x(a - span.begin, width), y + 2.5); pen.lineTo(Math.max(x(b - span.begin, width), x(a - span.begin, width) + 3), y + 2.5); pen.stroke(); }
    pen.setLineDash([]);
    for (const [t, action, phase] of agent.actions) { const px = x(t - span.begin, width); if (px < LEFT || px > width) continue; if (phase === "started") { triangle(px, y + height - 4, 4); marks.push({ px, y: y + height - 5, text: `${action} ${phase}` }); } }
    for (const [s, what, text, level] of others.get(agent.agent) || []) { const px = x(s, width); if (px < LEFT || px > width) continue; ring(px, y + height / 2, 3, level); marks.push({ px, y: y + height / 2, text: `${clock(s, 1)} ${what}: ${text}` }); }
    for (const [s, index] of byAgent.get(agent.agent) || []) { const px = x(s, width); if (px < LEFT - 6 || px > width) continue; diamond(px, y + 6, 5); marks.push({ px, y: y + 6, index, text: `${faults[index].brief || faults[index].unit}` }); }
  }
  pen.restore();
}
function bar(a, b, base, tall, width, least = 0.6) { const left = x(a - span.begin, width), right = x(b - span.begin, width); pen.fillRect(left, base - tall, Math.max(least, right - left), tall); }
function diamond(px, py, r) { pen.beginPath(); pen.moveTo(px, py - r); pen.lineTo(px + r, py); pen.lineTo(px, py + r); pen.lineTo(px - r, py); pen.closePath(); pen.fillStyle = colours.error; pen.fill(); pen.strokeStyle = colours.bg; pen.lineWidth = 1; pen.stroke(); }
function triangle(px, py, r) { pen.beginPath(); pen.moveTo(px, py - r); pen.lineTo(px + r, py + r * 0.6); pen.lineTo(px - r, py + r * 0.6); pen.closePath(); pen.fillStyle = colours.act; pen.fill(); pen.strokeStyle = colours.bg; pen.lineWidth = 1; pen.stroke(); }
function ring(px, py, r, level) { pen.beginPath(); pen.arc(px, py, r, 0, 7); pen.fillStyle = level ? colour(level) : colours.bg; pen.fill(); pen.strokeStyle = colours.fg; pen.lineWidth = 1; pen.stroke(); }
let asked = false;
function redraw() { if (!asked) { asked = true; requestAnimationFrame(() => { asked = false; draw(); }); } }
let later = 0;
function show(a, b) {
  const least = Math.min(0.5, whole); let width = Math.min(Math.max(b - a, least), whole);
  a = Math.min(Math.max(0, (a + b - width) / 2), whole - width); from = a; to = a + width; redraw();
  clearTimeout(later); later = setTimeout(() => { for (const plot of shown) plot.setScale("x", { min: from + span.begin, max: to + span.begin }); }, 120);
}
const zoom = (factor, at = (from + to) / 2) => show(at - (at - from) * factor, at + (to - at) * factor);
$("in").onclick = () => zoom(0.5); $("out").onclick = () => zoom(2); $("all").onclick = () => show(0, whole);
canvas.addEventListener("wheel", (event) => {
  if (!event.ctrlKey && !event.metaKey && Math.abs(event.deltaX) <= Math.abs(event.deltaY)) return;
  event.preventDefault();
  if (event.ctrlKey || event.metaKey) zoom(Math.exp(event.deltaY / 300), time(event.offsetX, canvas.clientWidth));
  else { const move = event.deltaX / (canvas.clientWidth - LEFT) * (to - from); show(from + move, to + move); }
}, { passive: false });
canvas.addEventListener("keydown", (event) => {
  const step = (to - from) / 5;
  const does = { "+": () => zoom(0.5), "=": () => zoom(0.5), "-": () => zoom(2), ArrowLeft: () => show(from - step, to - step), ArrowRight: () => show(from + step, to + step), Home: () => show(0, whole) }[event.key];
  if (does) { event.preventDefault(); does(); }
});
let drag = null;
canvas.addEventListener("pointerdown", (event) => { drag = { x: event.offsetX, from, to, moved: false }; canvas.setPointerCapture(event.pointerId); });
canvas.addEventListener("pointerup", (event) => { const was = drag; drag = null; canvas.classList.remove("drag"); if (was && !was.moved) click(event); });
canvas.addEventListener("pointercancel", () => { drag = null; canvas.classList.remove("drag"); });
canvas.addEventListener("pointermove", (event) => {
  if (drag) {
    const move = (drag.x - event.offsetX) / (canvas.clientWidth - LEFT - 8) * (drag.to - drag.from);
    if (Math.abs(drag.x - event.offsetX) > 4) drag.moved = true;
    if (drag.moved) { canvas.classList.add("drag"); show(drag.from + move, drag.to + move); }
    return;
  }
  hover(event);
});
canvas.addEventListener("pointerleave", () => { tip.hidden = true; });
const near = (event) => marks.filter((mark) => Math.hypot(mark.px - event.offsetX, mark.y - event.offsetY) < 9).sort((a, b) => (b.index !== undefined) - (a.index !== undefined));
const rowAt = (event) => rows.find((row) => event.offsetY >= row.y && event.offsetY < row.y + row.height);
function hover(event) {
  const row = rowAt(event), found = near(event);
  if (!row || event.offsetX < LEFT || row.unit && !row.segments.length) { tip.hidden = true; return; }
  const s = time(event.offsetX, canvas.clientWidth), t = s + span.begin;
  const segment = row.segments.find(([a, b]) => a <= t && t < b);
  const state = segment ? `${segment[2]} for ${long(segment[1] - segment[0])}` : "PHM not running, or nothing known";
  const armed = !row.unit && row.agent.armed.some(([a, b]) => a <= t && t < b) ? ", armed" : "";
  const joined = row.joined && segment ? ` (changes within ${long(row.joined)} are drawn as one)` : "";
  tip.textContent = [`${clock(s, 3)}  ${row.name}: ${state}${joined}${armed}`, ...found.slice(0, 6).map((mark) => mark.text)].join("\n");
  tip.hidden = false; tip.style.left = `${Math.min(event.clientX + 14, innerWidth - tip.offsetWidth - 8)}px`; tip.style.top = `${event.clientY + 16}px`;
}
function click(event) {
  const found = near(event).find((mark) => mark.index !== undefined);
  if (found) { reveal(found.index); return; }
  const row = rowAt(event);
  if (row && event.offsetX < LEFT && !row.unit) { if (!open.delete(row.agent.agent)) open.add(row.agent.agent); redraw(); }
}

// ---- faults
const table = $("faults"), body = table?.tBodies[0], faultRows = [];
const ended = (fault) => fault.outcome === "resolved" ? `by ${fault.by || "itself"}` : fault.outcome === "reattributed" ? `follows from ${fault.by}` : fault.outcome;
function fill() {
  if (!body) return;
  const part = document.createDocumentFragment();
  faults.forEach((fault, index) => {
    const row = element("tr", undefined, "row"); row.tabIndex = 0; row.setAttribute("aria-expanded", "false");
    const cells = [clock(fault.opened - span.begin, 3), fault.agent, fault.unit, fault.brief || fault.summary, fault.acted_after_s === null ? "-" : long(fault.acted_after_s), long(fault.lasted_s), ended(fault)];
    cells.forEach((cell, place) => row.append(element("td", cell, place === 6 ? fault.outcome : "")));
    row.onclick = () => toggle(index); row.onkeydown = (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); toggle(index); } };
    faultRows.push(row); part.append(row);
  });
  body.append(part); $("find").oninput = filter; filter();
}
function filter() {
  const words = $("find").value.toLowerCase().split(/\s+/).filter(Boolean); let count = 0;
  faults.forEach((fault, index) => {
    const text = `${fault.agent} ${fault.unit} ${fault.brief} ${fault.summary} ${fault.outcome} ${fault.by} ${fault.layer}`.toLowerCase(), hit = words.every((word) => text.includes(word));
    faultRows[index].hidden = !hit; if (faultRows[index].detail) faultRows[index].detail.hidden = !hit; count += hit;
  });
  $("count").textContent = `${count} of ${faults.length}`;
}
function toggle(index, force) {
  const row = faultRows[index], isOpen = Boolean(row.detail);
  if (isOpen && !force) { row.detail.remove(); row.detail = null; row.setAttribute("aria-expanded", "false"); return; }
  if (isOpen) return;
  row.detail = detail(faults[index]); row.after(row.detail); row.setAttribute("aria-expanded", "true");
}
function detail(fault) {
  const row = element("tr", undefined, "more"), cell = element("td"); cell.colSpan = 7;
  const facts = element("dl", undefined, "facts"), add = (name, value) => { if (value) facts.append(element("dt", name), element("dd", value)); };
  add("cause", fault.summary); add("possible causes", fault.suspects.join(", ")); add("consequences", [...new Set([...fault.blocks, ...fault.consequences])].join(", "));
  add("evidence", Object.entries(fault.evidence).map(([key, value]) => `${key} ${value}`).join(", "));
  add("detected", `${clock(fault.opened - span.begin, 3)}, ${fault.check} (layer ${fault.layer}, condition ${fault.condition || "-"}), fault ${fault.fault}`);
  for (const step of fault.steps) add(`+${(step.t - fault.opened).toFixed(1)} s`, `${step.action} ${step.phase}: ${step.text}`);
  add("ended", `${ended(fault)}, after ${long(fault.lasted_s)}`);
  const lines = element("pre", fault.lines.map(([s, text]) => `${clock(s, 3)} ${text}`).join("\n"));
  const look = element("button", "Show in the timeline"); look.type = "button"; look.onclick = (event) => { event.stopPropagation(); const s = fault.opened - span.begin; show(s - Math.max(10, fault.lasted_s), s + 2 * Math.max(10, fault.lasted_s)); canvas.scrollIntoView({ block: "center" }); };
  cell.append(facts, lines, look); row.append(cell); return row;
}
function reveal(index) { $("find").value = ""; filter(); toggle(index, true); faultRows[index].scrollIntoView({ block: "center", behavior: "smooth" }); faultRows[index].focus({ preventScroll: true }); }

// ---- availability
const MOST_ROWS = 1000;
const lower = availability.map((row) => row.slice(0, 3).join(" ").toLowerCase());
function fillAvailable() {
  const words = $("find-available").value.toLowerCase().split(/\s+/).filter(Boolean), hits = availability.filter((_, place) => words.every((word) => lower[place].includes(word)));
  $("availability").tBodies[0].replaceChildren(...hits.slice(0, MOST_ROWS).map(([agent, kind, name, share, error, unknown]) => {
    const row = element("tr");
    for (const cell of [agent, kind, name, share === null ? "not known" : `${(100 * share).toFixed(3)} %`, long(error), long(unknown)]) row.append(element("td", cell));
    return row;
  }));
  $("count-available").textContent = hits.length > MOST_ROWS ? `the first ${MOST_ROWS} of ${hits.length}` : `${hits.length} of ${availability.length}`;
}
if ($("available")) { $("available").addEventListener("toggle", fillAvailable, { once: true }); $("find-available").oninput = fillAvailable; }

// ---- plots
const shown = [];
const value = (plot) => plot.name.replace(/^ground \S+ /, "").replace(/^\S+ /, "");
const metric = (plot) => (groups.find(([key]) => value(plot).startsWith(key)) || [null])[0];
const choice = element("select"), MOST_LINES = 40;
function fillPlots() {
  if (!plots.length) { $("choose").textContent = "The record has no measurements."; return; }
  for (const name of ["all agents", ...new Set(plots.map((plot) => plot.agent))]) choice.append(element("option", name));
  const label = element("label", "Of "); label.append(choice); $("choose").append(label); choice.onchange = drawPlots;
  new IntersectionObserver((seen, observer) => { if (seen.some((one) => one.isIntersecting)) { observer.disconnect(); drawPlots(); } }, { rootMargin: "300px" }).observe($("plots"));
}
function drawPlots() {
  for (const plot of shown.splice(0)) plot.destroy();
  $("plots").replaceChildren();
  const chosen = plots.filter((plot) => choice.value === "all agents" || plot.agent === choice.value);
  for (const [key, title, unit] of groups) {
    const mine = chosen.filter((plot) => metric(plot) === key), alone = new Set(mine.map((plot) => plot.agent)).size === 1;
    const head = `${title}${unit ? ` (${unit})` : ""}`;
    // Of one agent all are drawn, in several plots; of many agents the reader chooses one.
    if (!alone && mine.length > MOST_LINES) { drawPlot(`${head}, the first ${MOST_LINES} of ${mine.length}: choose an agent`, key, mine.slice(0, MOST_LINES)); continue; }
    for (let first = 0; first < mine.length; first += MOST_LINES) {
      const lines = mine.slice(first, first + MOST_LINES);
      drawPlot(mine.length > MOST_LINES ? `${head}, ${first + 1} to ${first + lines.length} of ${mine.length}` : head, key, lines);
    }
  }
}
function drawPlot(title, key, lines) {
  const box = element("div", undefined, "plot"), hue = (place) => `hsl(${Math.round(place * 137.5) % 360} 60% 48%)`;
  box.append(element("h3", title)); $("plots").append(box);
  const named = (plot) => [choice.value === "all agents" ? plot.agent : "", plot.name.replace(/^ground /, "").split(" ")[0], value(plot) === key ? "" : value(plot)].filter(Boolean).join(" ");
  // 2: a null ends the line also between the times of other lines.
  const joined = uPlot.join(lines.map((plot) => [plot.points[0].map((s) => s + span.begin), plot.points[1]]), lines.map(() => [0, 2]));
  const series = [{ value: (_, v) => v === null ? "-" : clock(v - span.begin) }, ...lines.map((plot, place) => ({ label: named(plot), stroke: hue(place), width: 1.3, spanGaps: false, points: { show: false } }))];
  const axis = { stroke: colours.dim, grid: { stroke: colours.line, width: 1 }, ticks: { stroke: colours.line } };
  const scales = { x: { min: from + span.begin, max: to + span.begin } };
  shown.push(new uPlot({ width: Math.max(280, box.clientWidth - 14), height: 190, series, scales, tzDate: (t) => uPlot.tzDate(new Date(t * 1000), "Etc/UTC"), axes: [{ ...axis, space: data.dated ? 150 : 90, values: (_, all) => all.map((t) => clock(t - span.begin)) }, { ...axis, size: 58 }], legend: { show: lines.length <= 12 }, cursor: { sync: { key: "t" } } }, joined, box));
}

palette(); draw(); fill(); fillPlots();
addEventListener("resize", redraw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { palette(); redraw(); if (shown.length) drawPlots(); });
document.documentElement.dataset.ready = "yes";
}
