// The controls of a replayed flight.

import { mayOperate, postJson } from "./api.js";
import { button, byId, el, setText } from "./dom.js";
import { checkSession } from "./live.js";
import { on, store, utcNow } from "./store.js";
import { toast } from "./toasts.js";
import { clock } from "./words.js";

const SPEEDS = [0.25, 0.5, 1, 2, 4, 8, 16, 60];
let parts = null;
let dragging = false;

export function startReplay() {
  on("ground", show);
  on("tick", times);
}

function show() {
  const replay = store.ground.replay;
  const bar = byId("replay");
  bar.hidden = !replay;
  if (!replay) return;
  if (!parts) build(bar);
  setText(parts.play, replay.playing ? "Pause" : "Play");
  parts.slider.min = String(replay.from_utc);
  parts.slider.max = String(replay.to_utc);
  parts.speed.value = String(replay.speed);
  for (const part of [parts.play, parts.slider, parts.speed]) part.disabled = !mayOperate();
  times();
}

function build(bar) {
  parts = {
    play: button("Play", () => send({ do: store.ground.replay.playing ? "pause" : "play" })),
    slider: el("input", { type: "range", step: "1", "aria-label": "Moment of the flight" }),
    time: el("time", {}),
    speed: el("select", { "aria-label": "Speed" }, ...SPEEDS.map((speed) => el("option", { value: speed, text: `${speed} ×` }))),
  };
  parts.slider.addEventListener("input", () => {
    dragging = true;
    setText(parts.time, clock(Number(parts.slider.value)));
  });
  parts.slider.addEventListener("change", () => {
    dragging = false;
    send({ do: "seek", utc: Number(parts.slider.value) });
  });
  parts.speed.addEventListener("change", () => send({ do: "speed", speed: Number(parts.speed.value) }));
  bar.append(el("strong", { text: "Replay" }), parts.play, parts.slider, parts.time, parts.speed);
}

function times() {
  const replay = store.ground.replay;
  if (!replay || !parts || dragging) return;
  const at = Math.min(utcNow() ?? replay.at_utc, replay.to_utc);
  parts.slider.value = String(at);
  parts.slider.setAttribute("aria-valuetext", clock(at));
  setText(parts.time, `${clock(at)} of ${clock(replay.from_utc)} to ${clock(replay.to_utc)} UTC`);
}

async function send(body) {
  try {
    await postJson("api/replay", body);
  } catch (error) {
    toast(error.message, "error");
    checkSession(error);
  }
}
