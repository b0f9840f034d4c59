// The swarm: a row for each agent, a cell for each slot, the worst first. Only cells that changed are touched.

import { byId, el, setAttribute, setClass, setText } from "./dom.js";
import { ageOf, on, store } from "./store.js";
import { SLOTS, age, autopilotWords, cell, hopWords, order, slotLong, slotShort, stateClass } from "./words.js";

const STILL_MS = 1500;
const rows = new Map();
let body = null;
let current = "";
let opened = "";
let touched = 0;
let later = 0;

/** Build the empty grid. open: called with the name of the agent that is chosen. */
export function startGrid(open) {
  const head = el("div", { role: "row", class: "row head" });
  head.append(heading("Agent", "name"), heading("State", "how"), heading("Age", "age"), heading("Autopilot", "autopilot"));
  for (const slot of SLOTS) {
    head.append(el("div", { role: "columnheader", class: `s-${slot}`, title: `${slot} ${slotLong(slot)}`, "aria-label": slotLong(slot) },
      el("span", { text: slot }), el("span", { text: slotShort(slot) })));
  }
  head.append(heading("Broken at, last line", "note"));
  body = el("div", { role: "rowgroup", class: "rows" });
  const empty = el("p", { id: "empty", class: "empty", text: "No agent received yet." });
  byId("grid").append(el("div", { role: "table", class: "table", "aria-label": "Agents by slots, the worst first" },
    el("div", { role: "rowgroup" }, head), body), empty, legend());
  body.addEventListener("click", (event) => {
    const name = event.target.closest(".row")?.dataset.name;
    if (name) open(name);
  });
  body.addEventListener("keydown", (event) => move(event));
  body.addEventListener("focusin", (event) => choose(event.target.closest(".row")?.dataset.name));
  for (const event of ["pointerdown", "pointermove"]) body.addEventListener(event, () => (touched = performance.now()), { passive: true });
  on("rows", update);
  on("link", () => update(rows.keys()));
  on("tick", ages);
}

/** Mark the row of the agent whose details are open; empty: none. */
export function markOpen(name) {
  const before = rows.get(opened);
  opened = name;
  for (const row of [before, rows.get(name)]) if (row) show(row, store.agents.get(row.name));
}

export function focusRow(name) {
  rows.get(name || current)?.button.focus();
}

function heading(text, name) {
  return el("div", { role: "columnheader", class: name, text });
}

function legend() {
  const part = (name, text, words) => el("li", {}, el("span", { class: `slot ${name}`, text }), words);
  return el("ul", { class: "legend", "aria-label": "Meaning of the cells" }, part("ok", "OK", "works"), part("warn", "WARN", "limited"),
    part("error", "ERROR", "failed"), part("none", "–", "unknown or unused"), part("lost", "?", "not received"));
}

function update(names) {
  let resort = false;
  for (const name of names) {
    const agent = store.agents.get(name);
    let row = rows.get(name);
    if (!agent) {
      if (row) row.node.remove();
      rows.delete(name);
      continue;
    }
    if (!row) {
      row = makeRow(name);
      rows.set(name, row);
      resort = true;
    }
    resort = resort || row.rank !== agent.rank;
    show(row, agent);
  }
  byId("empty").hidden = rows.size > 0;
  if (resort) sort();
  if (!rows.has(current)) choose(body.firstElementChild?.dataset.name ?? "");
}

function makeRow(name) {
  const parts = { name, rank: null, cells: {} };
  parts.button = el("button", { type: "button", tabindex: name === current ? "0" : "-1" });
  parts.alarm = el("span", { class: "bell", "aria-hidden": "true" });
  parts.how = el("span", {});
  parts.age = el("div", { role: "cell", class: "age" });
  parts.autopilot = el("div", { role: "cell", class: "autopilot" });
  parts.hop = el("bdi", { class: "hop" });
  parts.line = el("bdi", { class: "line" });
  parts.node = el("div", { role: "row", class: "row", "data-name": name },
    el("div", { role: "cell", class: "name" }, parts.button, parts.alarm), el("div", { role: "cell", class: "how" }, parts.how),
    parts.age, parts.autopilot);
  for (const slot of SLOTS) {
    parts.cells[slot] = el("div", { role: "cell", title: slotLong(slot) });
    parts.node.append(parts.cells[slot]);
  }
  parts.node.append(el("div", { role: "cell", class: "note" }, parts.hop, parts.line));
  return parts;
}

function show(row, agent) {
  if (!agent) return;
  const rings = agent.alarm?.count > 0;
  setText(row.button, agent.name);
  setAttribute(row.button, "aria-label", `${agent.name}, ${agent.how}${rings ? `, ${agent.alarm.count} CRITICAL not acknowledged` : ""}`);
  setAttribute(row.button, "aria-expanded", String(agent.name === opened));
  setText(row.alarm, rings ? `! ${agent.alarm.count}` : "");
  setText(row.how, agent.how);
  setClass(row.how, `state ${stateClass(agent.how)}`);
  const [autopilotClass, autopilotText] = autopilotWords(agent.autopilot);
  setText(row.autopilot, autopilotText);
  setClass(row.autopilot, `autopilot p-${autopilotClass}`);
  for (const slot of SLOTS) {
    const [name, text] = cell(agent, slot);
    setText(row.cells[slot], text);
    setClass(row.cells[slot], `slot ${name} s-${slot}`);
  }
  setText(row.hop, hopWords(agent.hop));
  setText(row.line, agent.problem ?? lineWords(agent));
  setClass(row.node, `row r-${stateClass(agent.how)} ${agent.presence === "late" ? "late" : ""} ${agent.name === opened ? "open" : ""} ${rings ? "rings" : ""}`);
  showAge(row, agent);
}

function lineWords(agent) {
  if (!agent.line) return agent.swarm_says ? `by swarm: ${agent.swarm_says}` : "";
  const text = agent.line.text;
  return text.startsWith(`${agent.name} `) ? text.slice(agent.name.length + 1) : text;
}

function showAge(row, agent) {
  setText(row.age, agent.at === null ? "never" : age(ageOf(agent.at)));
}

function ages() {
  for (const row of rows.values()) {
    const agent = store.agents.get(row.name);
    if (agent) showAge(row, agent);
  }
}

/** The worst first. Rows stay where they are while the pointer is over them: a row must not move under a finger. */
function sort() {
  clearTimeout(later);
  const still = performance.now() - touched;
  if (still < STILL_MS && body.childElementCount) {
    for (const row of rows.values()) if (!row.node.isConnected) body.append(row.node);
    later = setTimeout(sort, STILL_MS - still + 50);
    return;
  }
  const focused = body.contains(document.activeElement) ? document.activeElement : null;
  let place = body.firstElementChild;
  for (const agent of [...store.agents.values()].sort(order)) {
    const row = rows.get(agent.name);
    if (!row) continue;
    row.rank = agent.rank;
    if (row.node === place) place = place.nextElementSibling;
    else body.insertBefore(row.node, place);
  }
  if (focused && document.activeElement !== focused) focused.focus({ preventScroll: true });
}

function choose(name) {
  if (!name || name === current) return;
  rows.get(current)?.button.setAttribute("tabindex", "-1");
  current = name;
  rows.get(current)?.button.setAttribute("tabindex", "0");
}

function move(event) {
  const here = event.target.closest(".row");
  if (!here) return;
  const to = {
    ArrowDown: () => here.nextElementSibling, ArrowUp: () => here.previousElementSibling,
    Home: () => body.firstElementChild, End: () => body.lastElementChild,
  }[event.key]?.();
  if (!to) return;
  event.preventDefault();
  rows.get(to.dataset.name).button.focus();
}
