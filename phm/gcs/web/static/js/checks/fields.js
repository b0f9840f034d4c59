// One field of the form: a label, a control, what it means, and its problem.

import { el } from "../dom.js";
import { dotted, valueOf } from "./schema.js";

let last = 0;

/** A field for a scalar. make: {path, name, about, value, required, change, suggest}. */
export function scalarField(make) {
  const control = make.about.choice.words.length || onlyBoolean(make.about.choice) ? choiceOf(make) : inputOf(make);
  control.addEventListener("change", () => {
    const value = valueOf(control.value, make.about.choice);
    const gone = value === undefined;
    // An entry of a list has no default to fall back to.
    if (gone && typeof make.path.at(-1) === "number") make.change([{ do: "set", path: make.path, value: "" }]);
    else if (!gone || make.has()) make.change([gone ? { do: "remove", path: make.path } : { do: "set", path: make.path, value }]);
  });
  return field(make, control);
}

/** A field for a value without its own form: JSON. */
export function jsonField(make) {
  const control = el("textarea", { rows: 2, spellcheck: "false" });
  control.value = make.value === undefined ? "" : JSON.stringify(make.value);
  const made = field(make, control, "Written as JSON, e.g. {\"name\": [0, 1]}.");
  control.addEventListener("change", () => {
    try {
      const value = control.value.trim() === "" ? undefined : JSON.parse(control.value);
      if (value !== undefined) make.change([{ do: "set", path: make.path, value }]);
      else if (make.has()) make.change([{ do: "remove", path: make.path }]);
    } catch {
      showProblem(made, ["is not JSON: names and texts need double quotes"]);
    }
  });
  return made;
}

/** Show the messages at a field or a section; an empty list clears them. */
export function showProblem(node, messages) {
  const place = node.querySelector(":scope > .problem");
  place.textContent = messages.join("\n");
  place.hidden = messages.length === 0;
  const control = node.querySelector(":scope > input, :scope > select, :scope > textarea, :scope > .row > input");
  if (control) control.setAttribute("aria-invalid", String(messages.length > 0));
  node.classList.toggle("wrong", messages.length > 0);
}

/** An empty place for messages. */
export function problemPlace(id) {
  return el("p", { class: "problem", id, hidden: true });
}

function field(make, control, more = "") {
  const id = `f${(last += 1)}`;
  const key = dotted(make.path);
  control.id = id;
  control.dataset.focus = key;
  control.setAttribute("aria-describedby", `${id}-help ${id}-problem`);
  if (make.required) control.setAttribute("aria-required", "true");
  const name = el("label", { for: id, text: make.name }, make.required ? el("span", { class: "required", text: " (required)" }) : null);
  const row = make.remove ? el("div", { class: "row" }, control, make.remove) : control;
  const help = el("p", { class: "help", id: `${id}-help`, text: [meaning(make), more].filter(Boolean).join(" ") });
  return el("div", { class: "field", "data-key": key }, name, row, help, problemPlace(`${id}-problem`));
}

function meaning({ about, hideHelp }) {
  const parts = [hideHelp ? "" : about.description];
  const choice = about.choice;
  if (choice?.units.length) parts.push(`Unit: ${choice.units.join(", ")}.`);
  const { minimum, maximum } = choice?.limits || {};
  if (minimum !== undefined && maximum !== undefined) parts.push(`From ${minimum} to ${maximum}.`);
  return parts.filter(Boolean).join(" ");
}

function onlyBoolean(choice) {
  return choice.boolean && !choice.number && !choice.text;
}

function choiceOf({ about, value, required }) {
  const words = about.choice.words.length ? about.choice.words : ["true", "false"];
  const control = el("select");
  const preset = about.default === undefined || about.default === null ? "not set" : `default: ${about.default}`;
  control.append(el("option", { value: "", text: required ? "choose" : preset }));
  const present = textOf(value);
  const all = present && !words.map(String).includes(present) ? [...words, present] : words;
  for (const word of all) control.append(el("option", { value: word, text: word }));
  control.value = present;
  return control;
}

function inputOf({ about, value, suggest }) {
  const preset = about.default;
  const hint = preset === undefined || preset === null || typeof preset === "object" || preset === "" ? "" : `default: ${preset}`;
  const control = el("input", { type: "text", placeholder: hint, autocomplete: "off", autocapitalize: "off", spellcheck: "false", list: suggest });
  control.value = textOf(value);
  return control;
}

/** A value as a field shows it; a list or a section where none belongs is shown as JSON. */
function textOf(value) {
  if (value === undefined || value === null) return "";
  return typeof value === "object" ? JSON.stringify(value) : String(value);
}
