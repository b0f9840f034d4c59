// The form: made from the schema and the values, section by section when it is opened.

import { button, el } from "../dom.js";
import { jsonField, problemPlace, scalarField, showProblem } from "./fields.js";
import { describe, dotted, isObject, resolve } from "./schema.js";

const FIRST = ["custom", "containers", "ros"];
const TITLES = ["name", "alias", "path", "url", "label", "when"];

export class Form {
  /** change(edits, rebuild): applies edits; rebuild: the form has another shape afterwards. */
  constructor(node, schema, change) {
    this.node = node;
    this.root = schema;
    this.change = change;
    this.open = new Set(["custom", "containers"]);
    this.values = {};
    this.problems = [];
  }

  /** Show other values. */
  show(values) {
    this.values = values;
    const focused = this.node.contains(document.activeElement) ? document.activeElement.dataset.focus : "";
    const names = Object.keys(this.root.properties);
    const order = [...FIRST.filter((name) => names.includes(name)), ...names.filter((name) => !FIRST.includes(name))];
    this.node.replaceChildren(...order.map((name) => this.place([name], this.root.properties[name], false, true)));
    if (focused) this.focus(focused);
    this.mark(this.problems);
  }

  /** The same form, with values that an edit changed. */
  update(values) {
    this.values = values;
    for (const title of this.node.querySelectorAll("[data-title]")) title.textContent = this.title(JSON.parse(title.dataset.title));
  }

  /** Show each problem at its field, or at the closest section that is there. */
  mark(problems) {
    this.problems = problems;
    const places = new Map([...this.node.querySelectorAll("[data-key]")].map((node) => [node.dataset.key, { node, said: [] }]));
    for (const problem of problems) {
      let key = problem.key;
      while (key && !places.has(key)) key = parentOf(key);
      const message = key === problem.key ? problem.message : `${problem.key}: ${problem.message}`;
      places.get(key)?.said.push(message);
    }
    for (const { node, said } of places.values()) showProblem(node, said);
  }

  focus(key) {
    this.node.querySelector(`[data-focus="${CSS.escape(key)}"]`)?.focus();
  }

  /** Open what contains a place, and go there. */
  reveal(key) {
    for (const part of key.matchAll(/[.[]|$/g)) this.open.add(key.slice(0, part.index));
    this.show(this.values);
    let near = key;
    while (near && !this.node.querySelector(`[data-key="${CSS.escape(near)}"]`)) near = parentOf(near);
    const place = this.node.querySelector(`[data-key="${CSS.escape(near)}"]`);
    place?.querySelector("input, select, textarea, summary")?.focus();
  }

  get(path) {
    return path.reduce((at, part) => (at === null || at === undefined ? undefined : at[part]), this.values);
  }

  title(path) {
    const value = this.get(path);
    const name = TITLES.map((key) => value?.[key]).find((one) => one) || "";
    const type = value?.type && value?.name ? `${value.type} ` : "";
    return `${dotted(path.slice(-2))}${name ? `: ${type}${name}` : ""}`;
  }

  place(path, schema, required, top = false) {
    const value = this.get(path);
    const about = describe(schema, this.root, value);
    const make = { path, about, value, required, name: String(path.at(-1)), suggest: suggestions(path), change: (edits) => this.change(edits, false) };
    make.has = () => this.get(path) !== undefined;
    if (about.kind === "scalar") return scalarField(make);
    if (about.kind === "json") return jsonField(make);
    const missing = about.kind === "object" && about.nullable && (value === undefined || value === null);
    const remove = about.kind === "object" && about.nullable && !missing ? [this.removal(path, make.name)] : [];
    return this.section(path, make.name, about.description, () => (missing ? [this.adding(path, make.name)] : [...remove, ...this.inside(path, about)]), top);
  }

  /** A part that can be opened; its content is made then. */
  section(path, name, description, content, top, title = null) {
    const key = dotted(path);
    const body = el("div", { class: "body" });
    const summary = el("summary", { "data-focus": `${key}?` }, title || el("span", { class: "name", text: name }), el("span", { class: "count", text: this.count(path) }));
    const node = el("details", { class: top ? "section first" : "section", "data-key": key }, summary, problemPlace(null), body);
    const fill = () => body.replaceChildren(description ? el("p", { class: "help", text: description }) : "", ...content());
    node.open = this.open.has(key);
    if (node.open) fill();
    node.addEventListener("toggle", () => {
      if (node.open === this.open.has(key)) return;
      this.open[node.open ? "add" : "delete"](key);
      if (node.open) fill();
      else body.replaceChildren();
      this.mark(this.problems);
    });
    return node;
  }

  count(path) {
    const value = this.get(path);
    if (Array.isArray(value)) return value.length === 1 ? "1 entry" : `${value.length} entries`;
    return value === undefined || value === null ? "not set" : "";
  }

  inside(path, about) {
    if (about.kind === "object") return this.fields(path, about.schema);
    if (about.kind === "list") return this.list(path, about);
    if (about.kind === "map") return this.map(path, about);
    return this.variant(path, about);
  }

  fields(path, schema, fixed = "") {
    const needed = schema.required || [];
    const names = Object.keys(schema.properties).filter((name) => name !== fixed);
    const sorted = [...names.filter((name) => needed.includes(name)), ...names.filter((name) => !needed.includes(name))];
    return sorted.map((name) => this.place([...path, name], schema.properties[name], needed.includes(name)));
  }

  /** One entry of a discriminated union. */
  variant(path, about) {
    const type = this.get(path)?.[about.tag];
    const schema = Object.hasOwn(about.types, type) ? about.types[type] : null;
    if (!schema) return [el("p", { class: "help", text: `${about.tag}: ${type} is not known: remove the entry, or change it in the YAML` })];
    return [el("p", { class: "help", text: schema.description || "" }), ...this.fields(path, schema, about.tag)];
  }

  list(path, about) {
    const entries = Array.isArray(this.get(path)) ? this.get(path) : [];
    const item = describe(about.items, this.root);
    const made = entries.map((value, index) => this.entry([...path, index], about.items));
    return [...made, this.addTo(path, item)];
  }

  entry(path, schema) {
    const about = describe(schema, this.root, this.get(path));
    const name = dotted(path.slice(-2));
    const remove = () => this.removal(path, name);
    if (about.kind === "scalar") {
      const make = { path, about, value: this.get(path), name, suggest: suggestions(path), hideHelp: true, has: () => true, remove: remove(), change: (edits) => this.change(edits, false) };
      return scalarField(make);
    }
    const title = el("span", { class: "name", "data-title": JSON.stringify(path), text: this.title(path) });
    return this.section(path, name, "", () => [remove(), ...this.inside(path, about)], false, title);
  }

  map(path, about) {
    const entries = isObject(this.get(path)) ? Object.keys(this.get(path)) : [];
    const item = resolve(about.items, this.root);
    const made = entries.map((name) => {
      const inner = describe(about.items, this.root, this.get([...path, name]));
      return this.section([...path, name], name, "", () => [this.removal([...path, name], name), ...this.inside([...path, name], inner)], false);
    });
    const id = `new-${dotted(path)}`;
    const input = el("input", { id, type: "text", list: suggestions([...path, ""]), "data-focus": `${dotted(path)}+`, autocomplete: "off", autocapitalize: "off" });
    const add = button(`Add to ${dotted(path)}`, () => {
      if (input.value.trim()) this.adds([...path, input.value.trim()], { do: "set", path: [...path, input.value.trim()], value: item.type === "array" ? [] : {} });
    });
    return [...made, el("div", { class: "add" }, el("label", { for: id, text: `Name of a new entry of ${dotted(path)}` }), input, add)];
  }

  addTo(path, item) {
    const next = [...path, Array.isArray(this.get(path)) ? this.get(path).length : 0];
    const value = (type) => (item.kind === "union" ? { [item.tag]: type } : item.kind === "object" ? {} : item.kind === "list" ? [] : "");
    const name = dotted(path);
    if (item.kind !== "union") return el("div", { class: "add" }, button(`Add to ${name}`, () => this.adds(next, { do: "add", path, value: value() })));
    const select = el("select", { id: `new-${name}`, "data-focus": `${name}+` });
    for (const [type, schema] of Object.entries(item.types)) select.append(el("option", { value: type, text: `${type}: ${schema.description || ""}` }));
    const add = button(`Add to ${name}`, () => this.adds(next, { do: "add", path, value: value(select.value) }));
    return el("div", { class: "add" }, el("label", { for: select.id, text: `Type of a new entry of ${name}` }), select, add);
  }

  adding(path, name) {
    return el("div", { class: "add" }, button(`Add ${name}`, () => this.adds(path, { do: "set", path, value: {} })));
  }

  removal(path, name) {
    const what = this.title(path);
    return button(`Remove ${name}`, () => this.change([{ do: "remove", path }], true), { class: "remove", "aria-label": `Remove ${what}` });
  }

  /** Add something, and go to its first field. */
  async adds(path, edit) {
    this.open.add(dotted(path));
    if (!(await this.change([edit], true))) return;
    const place = this.node.querySelector(`[data-key="${CSS.escape(dotted(path))}"]`);
    (place?.querySelector("input, select, textarea") || place?.querySelector("summary"))?.focus();
  }
}

/** A shorter key, whatever characters the file has in it. */
function parentOf(key) {
  return key.slice(0, Math.max(key.lastIndexOf("."), key.lastIndexOf("["), 0));
}

/** The list of names that fits a place. */
function suggestions(path) {
  const names = path.filter((part) => typeof part === "string");
  if (names.at(-1) === "needs") return "names-units";
  if (names.at(-1) === "container") return "names-containers";
  return names.length === 2 && names[0] === "checks" ? "names-checks" : null;
}
