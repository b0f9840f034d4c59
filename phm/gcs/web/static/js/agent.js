// One agent: where its path is broken, its layers and checks, open faults, requests, plots, what others say, recent events.

import { alarm } from "./alarms.js";
import { requestList, showChoices } from "./actions.js";
import { getJson, mayOperate } from "./api.js";
import { button, byId, el, render, said, setClass, setText } from "./dom.js";
import { eventLine } from "./events.js";
import { path } from "./path.js";
import { startPlots, stopPlots } from "./plots.js";
import { ageOf, now, on, store, utcNow } from "./store.js";
import { LAYERS, PRESENCE, age, ago, autopilotWords, cell, clock, received, slotLong, stateClass } from "./words.js";

const FAULTS_EVERY_MS = 5000;
const AGAIN_MS = 3000;
const MOST_EVENTS = 20;
const MOST_ENDED = 10;
const RECENT_S = 900;
const CHOICE_KEYS = ["advice", "containers", "on_hold", "presence"];
let shown = "";
let parts = {};
let faults = [];
let faultsNote = "";
let timer = 0;
let past = [];
let choicesFor = "";

export function startAgent() {
  on("rows", (names) => names.has(shown) && show());
  on("events", (found) => found.some((event) => event.who === shown) && recent());
  on("requests", () => shown && requests());
  on("link", () => shown && (show(), store.link === "live" && loadFaults()));
  on("tick", ages);
}

/** Show this agent beside the grid; empty: none. */
export function showAgent(name) {
  if (name === shown) return;
  shown = name;
  clearInterval(timer);
  stopPlots();
  const panel = byId("panel");
  panel.hidden = !name;
  document.body.classList.toggle("paneled", Boolean(name));
  if (!name) return panel.replaceChildren();
  [faults, faultsNote, choicesFor, past] = [[], "", "", []];
  build(panel, name);
  show();
  recent();
  requests();
  loadFaults();
  loadEvents(name);
  timer = setInterval(loadFaults, FAULTS_EVERY_MS);
  startPlots(parts.plots, name);
  parts.title.focus();
}

function build(panel, name) {
  parts = {
    title: el("h2", { tabindex: "-1", text: name }), state: el("span"), age: el("span", { class: "age" }), facts: el("p", { class: "facts" }),
    alarm: el("div", { class: "own-alarm" }), gone: el("p", { class: "gone", hidden: true }), path: el("div"), choices: el("div", { class: "choices" }),
    requests: el("div"), layers: el("div", { class: "layers" }), faults: el("div"), ended: el("div"), views: el("div"), plots: el("div"), events: el("div"),
  };
  parts.endedSection = section("Ended faults", parts.ended);
  parts.endedSection.hidden = true;
  panel.setAttribute("aria-label", `Agent ${name}`);
  panel.replaceChildren(
    el("header", {}, parts.title, parts.state, parts.age, el("a", { class: "close", href: "#/swarm", text: "Close", "aria-label": `Close ${name}` })),
    parts.facts, parts.alarm, parts.gone,
    section("Path of a command", parts.path), section("Open faults", parts.faults), parts.endedSection, section("Requests", parts.choices, parts.requests),
    section("Layers and checks", parts.layers), section("Plots", parts.plots), section("The ground's view and the swarm's", parts.views),
    section("Recent events", parts.events));
  panel.scrollTop = 0;
}

function section(title, ...children) {
  return el("section", {}, el("h3", { text: title }), ...children);
}

function show() {
  const agent = store.agents.get(shown);
  if (parts.gone) {
    parts.gone.hidden = Boolean(agent);
    setText(parts.gone, "This agent is currently unknown.");
  }
  if (!agent) return;
  setText(parts.state, agent.how);
  setClass(parts.state, `state ${stateClass(agent.how)}`);
  const [, autopilot] = autopilotWords(agent.autopilot);
  render(parts.facts, [agent.presence, autopilot, agent.link, agent.restarts, agent.on_hold, agent.period_s, agent.autopilot?.mode], () =>
    [PRESENCE[agent.presence] ?? agent.presence, `autopilot ${autopilot}`, agent.link ? `link ${agent.link}` : "",
      agent.period_s ? `a heartbeat each ${agent.period_s} s` : "", agent.restarts ? `PHM restarted or reloaded ${agent.restarts} times` : "",
      agent.on_hold ? "on hold" : ""].filter(Boolean).map((text) => el("span", { class: "fact" }, said(text))));
  showAlarm(agent);
  render(parts.path, agent.hops, () => path(agent.hops ?? []));
  render(parts.layers, [received(agent), agent.slots, agent.last_slots, agent.bad, agent.checks], () => layers(agent));
  render(parts.views, viewKey(agent), () => views(agent));
  showFaults(agent);
  // The confirmation of a restart says whether the vehicle is armed.
  const key = JSON.stringify([...CHOICE_KEYS.map((name) => agent[name]), agent.autopilot?.armed, agent.autopilot?.presence]);
  if (key !== choicesFor && store.link === "live") {
    choicesFor = key;
    askChoices(key);
  }
  ages();
}

/** Again with a later update if the server did not answer: it may be busy. */
async function askChoices(key) {
  if (await showChoices(parts.choices, shown)) return;
  setTimeout(() => { if (choicesFor === key) choicesFor = ""; }, AGAIN_MS);
}

function showAlarm(agent) {
  const count = agent.alarm?.count ?? 0;
  const until = agent.alarm?.silent_until ?? null;
  // Its own silence may end earlier than that of all: to end it would change nothing.
  const ofAll = until !== null && until === store.ground.alarms_silent_until;
  render(parts.alarm, [count, until, ofAll, mayOperate()], () => {
    if (!count && !until) return [];
    const words = [count ? `${count} CRITICAL not acknowledged` : "", until ? `silenced for ${age(until - (now() ?? until))}` : ""];
    return [el("strong", { text: words.filter(Boolean).join(", ") }), ...(mayOperate() ? [
      count ? button("Acknowledge", () => alarm({ do: "acknowledge", agent: shown })) : null,
      until ? button(ofAll ? "End the silence of all agents" : "End the silence", () => alarm({ do: "unsilence", agent: ofAll ? null : shown }))
        : button("Silence 10 min", () => alarm({ do: "silence", agent: shown, for_s: 600 })),
    ] : [])];
  });
}

function ages() {
  const agent = store.agents.get(shown);
  if (!agent) return;
  setText(parts.age, agent.at === null ? "never received" : `heartbeat ${ago(ageOf(agent.at))}`);
  for (const node of byId("panel").querySelectorAll("[data-at]")) setText(node, ago(ageOf(Number(node.dataset.at))));
}

function since(at) {
  return el("span", { class: "since", "data-at": at });
}

function layers(agent) {
  return LAYERS.map(([layer, title, slots]) => {
    const checks = (agent.checks ?? []).filter((check) => check.layer === layer);
    const lines = checks.length ? checks.map(checkLine) : slots.map((slot) => slotLine(agent, slot));
    return el("section", { class: "layer" }, el("h4", { text: title }), el("ul", {}, ...lines));
  });
}

function checkLine(check) {
  const name = { OK: "ok", WARN: "warn", ERROR: "error" }[check.level] ?? "none";
  return el("li", {}, el("span", { class: `slot ${name}`, text: name === "none" ? "–" : check.level }),
    el("span", { class: "reasons" }, el("strong", {}, said(check.unit)), check.text ? el("p", {}, said(check.text)) : null));
}

function slotLine(agent, slot) {
  const [name, text] = cell(agent, slot);
  const reasons = (agent.bad ?? []).filter((bad) => String(bad.slot) === slot);
  const last = name === "lost" ? agent.last_slots?.[slot] : "";
  const words = { ok: "works", warn: "limited", error: "failed", none: "unknown or unused", lost: "not received" }[name];
  return el("li", {}, el("span", { class: `slot ${name}`, text }), el("span", { class: "reasons" },
    el("strong", { text: `${slot} ${slotLong(slot)} ` }), el("span", { class: "quiet", text: last ? `last: ${last}` : words }),
    ...reasons.map((bad) => el("p", { class: `r-${bad.level}` }, said(bad.text), " ", since(bad.at)))));
}

async function loadFaults() {
  const name = shown;
  if (!name || store.link !== "live") return;
  let found = [];
  let note = "";
  try {
    const since = utcNow() - RECENT_S;
    const flight = await getJson("api/history/flight", { agent: name });
    const flying = flight.since !== null && (flight.until === null || flight.until > since);
    found = (await getJson("api/history/faults", { agent: name, since: flying ? Math.min(since, flight.since) : since })).faults;
  } catch (error) {
    note = error.status === 404 ? "There is no history: steps of faults are not kept." : `No faults: ${error.message}.`;
  }
  if (name !== shown) return;
  [faults, faultsNote] = [found, note];
  const agent = store.agents.get(shown);
  if (agent) showFaults(agent);
}

function showFaults(agent) {
  const [open, ended] = [faults.filter((fault) => fault.open), faults.filter((fault) => !fault.open)];
  render(parts.faults, [open, faultsNote, agent.advice, agent.bad?.length], () => [
    ...(agent.advice ?? []).map((one) => el("p", { class: "advice" }, el("strong", { text: `Waits for an approval: fault ${one.fault}: ` }),
      said(`${one.action} ${one.target}`), " ", since(one.at))),
    ...open.map(faultItem),
    !open.length && !agent.advice?.length ? el("p", { class: "quiet",
      text: agent.bad?.length ? `Reported as bad: see below. ${faultsNote}` : faultsNote || "No open fault is known." }) : null,
  ]);
  parts.endedSection.hidden = !ended.length;
  render(parts.ended, ended, () => [...ended.slice(0, MOST_ENDED).map(faultItem),
    ended.length > MOST_ENDED ? el("p", { class: "quiet", text: `${ended.length - MOST_ENDED} earlier ones: see Events.` }) : null]);
}

function faultItem(fault) {
  return el("article", { class: fault.open ? "fault" : "fault ended" },
    el("h4", {}, said(fault.unit || slotLong(fault.slot)), ": ", said(fault.text), fault.open ? "" : `, ended ${clock(fault.ended_utc_s)}`),
    el("ol", { class: "stages", "aria-label": "Stages" }, ...stages(fault.steps).map(([name, reached, words]) =>
      el("li", { class: reached }, el("strong", { text: name }), ` ${words || "–"}`))),
    el("ol", { class: "steps" }, ...fault.steps.map((step) => el("li", {}, el("time", { text: clock(step.utc_s) }),
      el("strong", { text: step.step }), " ", said(step.text)))));
}

/** The stages of a fault: name, class, and time in words. */
function stages(steps) {
  const last = (...names) => steps.findLast((step) => names.includes(step.step));
  const stage = (name, step, className = "reached") => [name, step ? className : "", step ? clock(step.utc_s) : ""];
  const confirmed = steps.find((step) => step.step !== "detected");
  const detected = last("detected");
  const action = last("advised", "approved", "expired", "gave up", "action");
  const proof = last("proof", "recovered");
  return [
    // The ground receives a fault when it is confirmed; details say when it was detected.
    detected ? stage("detected", detected) : ["detected", "reached", confirmed ? `before ${clock(confirmed.utc_s)}` : ""],
    stage("confirmed", confirmed),
    ["expired", "gave up"].includes(action?.step) ? stage(action.step.toUpperCase(), action, "failed") : stage("action", last("action")),
    stage(proof?.step ?? "proof", proof),
  ];
}

function viewKey(agent) {
  const view = agent.view ? { ...agent.view, at: null } : null;
  return [agent.how, agent.swarm_says, agent.received_by, agent.not_received_by, agent.receives_ground, view, agent.view?.at];
}

function views(agent) {
  const answers = { true: "yes", false: "NO", null: "not reported" };
  const list = (names) => (names?.length ? names.map((number) => `A${String(number).padStart(2, "0")}`).join(" ") : "none");
  const peers = Object.entries(agent.view?.peers ?? {}).filter(([, seen]) => seen !== "alive");
  const differs = agent.swarm_says && agent.swarm_says !== agent.how;
  const line = (term, ...words) => [el("dt", { text: term }), el("dd", {}, ...words)];
  return el("dl", { class: "views" },
    ...line("The ground says", el("span", { class: `state ${stateClass(agent.how)}`, text: agent.how })),
    ...line("The swarm says", el("span", { class: `state ${stateClass(agent.swarm_says)}`, text: agent.swarm_says ?? "nothing" }),
      differs ? el("strong", { class: "differs", text: " ≠ they differ" }) : ""),
    ...line("Received by", list(agent.received_by)), ...line("Not received by", list(agent.not_received_by)),
    ...line("It receives the ground", answers[String(agent.receives_ground)] ?? "not reported"),
    ...(agent.view ? line("Its own view", `autopilot ${agent.view.autopilot ? "received" : "NOT received"}, radio ${agent.view.radio ? "works" : "does NOT work"}, `,
      peers.length ? `peers not alive: ${peers.map(([number, seen]) => `A${number.padStart(2, "0")} ${seen}`).join(", ")}, ` : "all peers alive, ",
      since(agent.view.at)) : line("Its own view", "not received")));
}

async function loadEvents(name) {
  let found = [];
  try {
    found = (await getJson("api/history/events", { agent: name, limit: MOST_EVENTS })).events;
  } catch {
    found = [];
  }
  if (name !== shown) return;
  past = found.filter((event) => event.words);
  recent();
}

function recent() {
  const fresh = store.events.filter((event) => event.who === shown && !(past.length && event.utc_s <= past[0].utc_s));
  const found = [...fresh.reverse(), ...past].slice(0, MOST_EVENTS);
  parts.events?.replaceChildren(found.length ? el("ol", { class: "log" }, ...found.map((event) => eventLine(event, false)))
    : el("p", { class: "quiet", text: "No event is known." }));
}

function requests() {
  parts.requests.replaceChildren(...[requestList(shown)].filter(Boolean));
}
