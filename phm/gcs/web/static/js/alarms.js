// New CRITICAL lines: a bell, a flash, and who has them, until the operator acknowledges.

import { mayOperate, postJson } from "./api.js";
import { button, byId, el, render, setText } from "./dom.js";
import { checkSession } from "./live.js";
import { ageOf, now, on, store } from "./store.js";
import { age, compare } from "./words.js";
import { toast } from "./toasts.js";

const MINUTES = [5, 10, 30];
const counts = new Map();
let audio = null;
let first = true;

export function startAlarms() {
  byId("sound").addEventListener("click", switchSound);
  // A browser plays no sound before the first touch or key.
  for (const event of ["pointerdown", "keydown"]) addEventListener(event, wake, { once: true });
  on("rows", update);
  on("ground", show);
  on("link", () => store.link === "live" || (first = true));
  on("tick", times);
}

function wake(event) {
  if (event.target?.id !== "sound" && localStorage.getItem("phm-sound") !== "off") turnOn();
}

function switchSound() {
  if (audio?.state === "running") {
    localStorage.setItem("phm-sound", "off");
    audio.suspend().then(showSound);
  } else {
    localStorage.setItem("phm-sound", "on");
    turnOn().then(ring);
  }
}

async function turnOn() {
  try {
    audio = audio ?? new AudioContext();
    await audio.resume();
  } catch {
    toast("This browser plays no sound.", "warn");
  }
  showSound();
}

function showSound() {
  const plays = audio?.state === "running";
  setText(byId("sound"), plays ? "Sound on" : "Sound off");
  byId("sound").setAttribute("aria-pressed", String(plays));
}

function ring() {
  if (audio?.state !== "running") return;
  for (const [at, pitch] of [[0, 880], [0.22, 660], [0.44, 880]]) {
    const tone = audio.createOscillator();
    const volume = audio.createGain();
    const start = audio.currentTime + at;
    tone.frequency.value = pitch;
    volume.gain.setValueAtTime(0.4, start);
    volume.gain.exponentialRampToValueAtTime(0.001, start + 0.2);
    tone.connect(volume).connect(audio.destination);
    tone.start(start);
    tone.stop(start + 0.2);
  }
}

function silent(alarm) {
  const current = now();
  return alarm.silent_until && current !== null && alarm.silent_until > current;
}

function update(names) {
  const fresh = [];
  for (const name of names) {
    const alarm = store.agents.get(name)?.alarm;
    if ((alarm?.count ?? 0) > (counts.get(name) ?? 0) && !silent(alarm)) fresh.push(name);
    counts.set(name, alarm?.count ?? 0);
  }
  // After a reconnection the page shows what is there; it rings for it as well, once.
  if (fresh.length) {
    const words = `New CRITICAL: ${fresh.slice(0, 5).join(", ")}${fresh.length > 5 ? ` and ${fresh.length - 5} more` : ""}`;
    setText(byId("said"), "");
    setText(byId("said"), words);
    ring();
    if (!first) flash();
  }
  first = false;
  show();
}

function flash() {
  document.body.classList.remove("flash");
  // Begin the animation again.
  void document.body.offsetWidth;
  document.body.classList.add("flash");
}

function ringing() {
  const found = [...store.agents.values()].filter((agent) => agent.alarm?.count > 0);
  // Expected agents first: a flood of invented ones must not hide theirs.
  return found.sort((left, right) => Number(right.alarm.expected) - Number(left.alarm.expected)
    || (right.alarm.at ?? 0) - (left.alarm.at ?? 0) || compare(left.name, right.name));
}

function show() {
  const found = ringing();
  const until = store.ground.alarms_silent_until ?? null;
  // Alarms for which the server had no room: at least one line each.
  const leftOut = store.ground.alarms_left_out ?? 0;
  const count = found.length + leftOut;
  const bar = byId("alarms");
  // Shown as long as no alarm would ring, so that this can be seen and ended.
  bar.hidden = !count && until === null;
  const total = found.reduce((sum, agent) => sum + agent.alarm.count, leftOut);
  document.title = `${total ? `(${total}!) ` : ""}PHM`;
  render(bar, [found.map((agent) => [agent.name, agent.alarm.count, Boolean(silent(agent.alarm))]), leftOut, until, mayOperate()], () => [
    el("strong", {}, count ? `${total} CRITICAL not acknowledged` : "", count && until ? ", " : "",
      until ? el("span", { "data-until": until }) : null),
    el("ul", {}, ...found.slice(0, 12).map((agent) => el("li", {},
      el("a", { href: `#/agent/${encodeURIComponent(agent.name)}`, text: `${agent.name} (${agent.alarm.count})` }),
      el("span", { class: "since", "data-name": agent.name }))),
      count > Math.min(found.length, 12) ? el("li", { text: `and ${count - Math.min(found.length, 12)} more` }) : null),
    mayOperate() ? controls(count, until) : null,
  ]);
  times();
}

function controls(count, until) {
  const end = until ? button("End the silence", () => alarm({ do: "unsilence", agent: null })) : null;
  if (!count) return el("span", { class: "controls" }, end);
  const minutes = el("select", { "aria-label": "Silence for", "data-focus": "minutes" },
    ...MINUTES.map((count) => el("option", { value: count, text: `${count} min` })));
  minutes.value = "10";
  return el("span", { class: "controls" }, button("Acknowledge all", () => alarm({ do: "acknowledge", agent: null })),
    button("Silence for", () => alarm({ do: "silence", agent: null, for_s: 60 * Number(minutes.value) })), minutes, end);
}

function times() {
  for (const node of byId("alarms").querySelectorAll(".since")) {
    const found = store.agents.get(node.dataset.name)?.alarm;
    if (found) setText(node, `${age(ageOf(found.at))}${silent(found) ? ", silenced" : ""}`);
  }
  for (const node of byId("alarms").querySelectorAll("[data-until]")) {
    const current = now();
    setText(node, `all agents are silenced${current === null ? "" : ` for ${age(Number(node.dataset.until) - current)}`}`);
  }
}

/** Acknowledge or silence; agent null: all. */
export async function alarm(body) {
  try {
    await postJson("api/alarms", body);
  } catch (error) {
    toast(error.message, "error");
    checkSession(error);
  }
}
