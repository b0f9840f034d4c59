// Short messages that stay until they are closed or a minute has passed.

import { byId, el, said } from "./dom.js";

const KEPT_MS = 60000;
const MOST = 5;

/** Show a message; grade: "ok", "warn", "error" or "info". */
export function toast(text, grade = "info") {
  const area = byId("toasts");
  const node = el("div", { class: `toast t-${grade}` }, said(text),
    el("button", { type: "button", "aria-label": "Close the message", text: "×", on: { click: () => node.remove() } }));
  area.append(node);
  while (area.childElementCount > MOST) area.firstElementChild.remove();
  setTimeout(() => node.remove(), KEPT_MS);
}
