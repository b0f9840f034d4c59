// The event log: search, filter, and older events from the history.

import { getJson } from "./api.js";
import { button, byId, el, said, setText } from "./dom.js";
import { historyProblem, on, store } from "./store.js";
import { clock, compare, day } from "./words.js";

const MOST = 400;
const GRADES = ["info", "ok", "warn", "error", "critical"];
const MARKS = { info: "INFO", ok: "OK", warn: "WARN", error: "ERROR", critical: "CRIT" };
const filter = { q: "", agent: "", grade: "" };
let list = null;
let more = null;
let note = null;
let oldest = null;
let loading = 0;
let shown = new Set();

export function startEvents() {
  list = el("ol", { class: "log", tabindex: "0", "aria-label": "Events, the newest first" });
  more = button("Older events", () => load(oldest), { hidden: true });
  note = el("p", { class: "quiet", role: "status" });
  byId("view-events").append(el("form", { class: "filters", role: "search", on: { submit: (event) => event.preventDefault() } },
    field("Search", el("input", { type: "search", id: "f-q", maxlength: 100, on: { input: debounced(apply) } })),
    field("Agent", el("select", { id: "f-agent", on: { change: apply } }, el("option", { value: "", text: "all" }))),
    field("At least", el("select", { id: "f-grade", on: { change: apply } }, el("option", { value: "", text: "all" }),
      ...GRADES.slice(2).map((grade) => el("option", { value: grade, text: MARKS[grade] })))), note), list, more);
  on("rows", names);
  on("events", add);
  on("link", () => store.link === "live" && load(null));
}

function field(label, input) {
  return el("label", { class: "field", for: input.id }, el("span", { text: label }), input);
}

function debounced(run) {
  let timer = 0;
  return () => {
    clearTimeout(timer);
    timer = setTimeout(run, 250);
  };
}

function names() {
  const select = byId("f-agent");
  const wanted = [...store.agents.keys()].sort(compare);
  if (select.options.length === wanted.length + 1) return;
  select.replaceChildren(el("option", { value: "", text: "all" }), ...wanted.map((name) => el("option", { value: name, text: name })));
  select.value = filter.agent;
}

function apply() {
  filter.q = byId("f-q").value.trim();
  filter.agent = byId("f-agent").value;
  filter.grade = byId("f-grade").value;
  load(null);
}

function fits(event) {
  return (!filter.agent || event.who === filter.agent) && (!filter.grade || GRADES.indexOf(event.grade) >= GRADES.indexOf(filter.grade)) &&
    (!filter.q || event.words.toLowerCase().includes(filter.q.toLowerCase()));
}

/** Show what fits: from the history, else what arrived since the page was opened. before: id, or null for the newest. */
async function load(before) {
  const number = ++loading;
  let found = [];
  let again = false;
  try {
    const answer = await getJson("api/history/events", { ...filter, before, limit: 200 });
    [found, again] = [answer.events.filter((event) => event.words), answer.more];
    oldest = answer.events.at(-1)?.id ?? null;
    if (!before && !filter.q && !filter.agent && !filter.grade && !store.events.length) store.events.push(...found.slice().reverse());
    setText(note, historyProblem());
  } catch (error) {
    if (number !== loading) return;
    if (!before) found = store.events.filter(fits).slice(-MOST).reverse();
    setText(note, error.status === 404 ? "Events since this page was opened: there is no history." : `No older events: ${error.message}. ${historyProblem()}`);
  }
  if (number !== loading) return;
  if (!before) found = withNewest(found, again);
  const lines = found.map((event) => eventLine(event, true));
  shown = new Set([...(before ? shown : []), ...found.map(key)]);
  if (before) list.append(...lines);
  else list.replaceChildren(...lines);
  more.hidden = !again;
  if (!list.childElementCount) setText(note, "No event fits.");
}

function key(event) {
  return `${event.utc_s} ${event.words}`;
}

/** The newest events are not in the history yet, which is written every few seconds. */
function withNewest(found, again) {
  const known = new Set(found.map(key));
  const from = again && found.length ? found.at(-1).utc_s : 0;
  const fresh = store.events.filter((event) => fits(event) && event.utc_s >= from && !known.has(key(event)));
  return [...fresh, ...found].sort((left, right) => right.utc_s - left.utc_s);
}

function add(found) {
  const fresh = found.filter((event) => fits(event) && !shown.has(key(event))).slice(-MOST);
  list.prepend(...fresh.reverse().map((event) => eventLine(event, true)));
  while (list.childElementCount > 2 * MOST) list.lastElementChild.remove();
  if (fresh.length) setText(note, "");
}

/** A line of the log. link: the agent leads to its details. */
export function eventLine(event, link) {
  const who = event.who && link ? el("a", { href: `#/agent/${encodeURIComponent(event.who)}`, text: event.who }) : el("span", { text: link ? event.who : "" });
  return el("li", { class: `g-${event.grade}` }, el("time", { text: clock(event.utc_s), title: `${day(event.utc_s)} UTC` }),
    el("span", { class: "mark", text: MARKS[event.grade] ?? "" }), link ? who : null, said(event.words));
}
