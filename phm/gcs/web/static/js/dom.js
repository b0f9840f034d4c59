// Building and changing the page. Text is always a text node: what comes from the air is never markup.

const SVG = "http://www.w3.org/2000/svg";

/** A new element. attributes: `class`, `text`, `on` ({event: listener}), and attributes by name; false and null are left out. */
export function el(tag, attributes = {}, ...children) {
  return fill(document.createElement(tag), attributes, children);
}

/** The same in SVG. */
export function svg(tag, attributes = {}, ...children) {
  return fill(document.createElementNS(SVG, tag), attributes, children);
}

function fill(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name === "text") node.textContent = String(value);
    else if (name === "on") for (const [event, listener] of Object.entries(value)) node.addEventListener(event, listener);
    else node.setAttribute(name, value === true ? "" : String(value));
  }
  node.append(...children.filter((child) => child !== null && child !== undefined && child !== false));
  return node;
}

const texts = new WeakMap();
const classes = new WeakMap();

/** Set the text of an element that has nothing else, if it is another one. */
export function setText(node, text) {
  if (texts.get(node) === text) return;
  texts.set(node, text);
  node.textContent = text;
}

/** Set the class of an element, if it is another one. */
export function setClass(node, name) {
  if (classes.get(node) === name) return;
  classes.set(node, name);
  node.setAttribute("class", name);
}

/** Set or remove an attribute, if it is another one. */
export function setAttribute(node, name, value) {
  if (value === null) node.removeAttribute(name);
  else if (node.getAttribute(name) !== value) node.setAttribute(name, value);
}

/** Replace the children of a node unless `key` is that of the last time: an unchanged part keeps focus and selection. */
export function render(node, key, make) {
  const text = JSON.stringify(key);
  if (texts.get(node) === text) return;
  texts.set(node, text);
  const focused = node.contains(document.activeElement) ? document.activeElement.dataset.focus : "";
  node.replaceChildren(...[make()].flat(2).filter((child) => child !== null && child !== undefined && child !== false));
  if (focused) node.querySelector(`[data-focus="${CSS.escape(focused)}"]`)?.focus({ preventScroll: true });
}

export function byId(id) {
  return document.getElementById(id);
}

/** A button with a text that says what it does. */
export function button(text, click, attributes = {}) {
  return el("button", { type: "button", "data-focus": text, ...attributes, text, on: { click } });
}

/** Text that someone else wrote: isolated, so that its direction does not change what is beside it. */
export function said(text, name = "") {
  return el("bdi", { class: `air ${name}`.trim(), text });
}
