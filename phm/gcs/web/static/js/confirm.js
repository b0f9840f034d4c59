// The dialog that asks before something is done. One question after the other.

import { button, byId, el } from "./dom.js";

let turn = Promise.resolve();

/** Ask. title, content: nodes and texts; yes: the text of the button that confirms. Returns whether it was pressed. */
export function confirmed(title, content, yes) {
  turn = turn.then(() => ask(title, content, yes));
  return turn;
}

function ask(title, content, yes) {
  const dialog = byId("dialog");
  let answer = false;
  const cancel = button("Cancel", () => dialog.close(), { autofocus: true });
  const confirm = button(yes, () => { answer = true; dialog.close(); }, { class: "act strong" });
  dialog.replaceChildren(el("h2", { id: "dialog-title" }, ...title), ...content, el("div", { class: "controls" }, cancel, confirm));
  dialog.showModal();
  cancel.focus();
  return new Promise((done) => dialog.addEventListener("close", () => done(answer), { once: true }));
}
