// What an operator may request of an agent: with a confirmation that says what will happen, and the answer in words.

import { getJson, mayOperate, postJson } from "./api.js";
import { confirmed } from "./confirm.js";
import { button, el, render, said } from "./dom.js";
import { checkSession } from "./live.js";
import { on, store, utcNow } from "./store.js";
import { toast } from "./toasts.js";
import { clock } from "./words.js";

const HOLD_MINUTES = [5, 10, 30, 60];
const STATES = { sent: "sent, no answer yet", answered: "answered", timeout: "no answer" };
const FRESH_S = 15;
const announced = new Map();

export function startActions() {
  on("requests", () => {
    for (const request of store.requests.values()) announce(request);
  });
}

/** The sentence about a request, once for each of its states. */
function announce(request) {
  const state = `${request.state} ${request.accepted} ${request.late}`;
  const before = announced.get(request.id);
  announced.set(request.id, state);
  if (before === state || request.state === "sent") return;
  // What was answered before this page was opened is not new.
  if (before === undefined && request.done_utc_s < utcNow() - FRESH_S) return;
  toast(request.sentence || `${request.agent} ${request.text}: ${STATES[request.state]}`, request.accepted ? "ok" : "error");
}

/** Fill `place` with the choices for this agent. Returns whether the server answered. */
export async function showChoices(place, name) {
  let found, answered = true;
  try {
    found = await getJson("api/choices", { agent: name });
  } catch (error) {
    found = { choices: [], note: error.status === 404 ? "No requests are possible here." : `No requests: ${error.message}.` };
    answered = error.status !== 0;
    checkSession(error);
  }
  render(place, [name, found, mayOperate()], () => [
    ...(mayOperate() ? found.choices.map((choice) => choiceButton(name, choice)) : []),
    mayOperate() ? null : el("p", { class: "quiet", text: "This session can only view: its role is view." }),
    found.note ? el("p", { class: "quiet" }, said(found.note)) : null,
  ]);
  return answered;
}

function choiceButton(name, choice) {
  const strong = choice.do === "approve" || choice.do === "restart";
  return button(choice.text, () => start(name, choice), { class: strong ? "act strong" : "act" });
}

async function start(name, choice) {
  const body = { agent: name, do: choice.do };
  for (const key of ["fault", "container", "for_s"]) if (choice[key] !== undefined) body[key] = choice[key];
  if (!choice.confirm) return send(body);
  const minutes = choice.do === "hold" ? holdTime() : null;
  const content = [
    el("p", {}, said(choice.will || "The agent is asked to do this.")),
    ...(minutes ? [el("p", {}, el("label", { for: "hold-time", text: "For " }), minutes)] : []),
    el("p", { class: "quiet", text: "Its answer is shown here." }),
  ];
  if (!await confirmed([`${name}: `, said(choice.text)], content, `Yes, ${choice.do}`)) return;
  return send(minutes ? { ...body, for_s: 60 * Number(minutes.value) } : body);
}

function holdTime() {
  const select = el("select", { id: "hold-time" }, ...HOLD_MINUTES.map((count) => el("option", { value: count, text: `${count} minutes` })));
  select.value = "10";
  return select;
}

async function send(body) {
  if (store.link !== "live") return toast("Not sent: there is no connection to the server.", "error");
  try {
    const request = await postJson("api/requests", body);
    if (!announced.has(request.id)) announced.set(request.id, `${request.state} ${request.accepted} ${request.late}`);
    toast(request.sentence || `${request.agent} ${request.text}: sent`, "info");
  } catch (error) {
    toast(`${body.agent}: not sent: ${error.message}`, "error");
    checkSession(error);
  }
}

/** Requests to this agent and their answers, the newest first. */
export function requestList(name) {
  const found = [...store.requests.values()].filter((request) => request.agent === name).reverse().slice(0, 8);
  if (!found.length) return null;
  return el("ul", { class: "requests" }, ...found.map((request) => {
    const grade = request.state === "sent" ? "info" : request.accepted ? "ok" : "error";
    return el("li", { class: `g-${grade}` }, el("time", { text: clock(request.sent_utc_s) }),
      said(request.sentence || `${request.text}: ${STATES[request.state] ?? request.state}`),
      request.late ? el("span", { class: "quiet", text: " (late)" }) : null);
  }));
}
