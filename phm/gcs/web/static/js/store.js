// The state of the swarm as the server sends it, and who is notified of changes. Changes are shown once per frame of the display.

const MAX_EVENTS = 2000;

export const store = { agents: new Map(), ground: {}, events: [], requests: new Map(), run: "", link: "connecting", since: 0 };

const watchers = { rows: [], ground: [], events: [], requests: [], link: [], tick: [] };
let dirty = { rows: new Set(), ground: false, events: [], requests: false, link: false };
let asked = false;
let server = { now: null, utc: null, at: 0 };

/** Call `watcher` when something of this kind changed. `rows` gets the names that changed, `events` the new ones. */
export function on(kind, watcher) {
  watchers[kind].push(watcher);
}

/** Seconds on the server's clock; null while there is no connection: no age is known then. */
export function now() {
  return counted(server.now);
}

/** UTC seconds on the server's clock; null without a connection. */
export function utcNow() {
  return counted(server.utc);
}

function counted(last) {
  if (last === null || store.link !== "live") return null;
  return last + ((performance.now() - server.at) / 1000) * (store.ground.rate ?? 1);
}

/** Age in seconds of what happened at `at`; null: never, or it is not known. */
export function ageOf(at) {
  const current = now();
  return at === null || at === undefined || current === null ? null : Math.max(0, current - at);
}

/** Why the history is incomplete, in words; else empty. */
export function historyProblem() {
  const problem = store.ground.history?.problem;
  return problem ? `The history is incomplete: ${problem}.` : "";
}

function stamp(message) {
  if (typeof message.now === "number") server = { now: message.now, utc: message.utc, at: performance.now() };
}

export function takeFull(message) {
  stamp(message);
  if (message.run !== store.run) store.requests.clear();
  store.run = message.run;
  store.ground = message.ground ?? {};
  for (const name of store.agents.keys()) dirty.rows.add(name);
  store.agents = new Map(Object.entries(message.agents ?? {}));
  for (const name of store.agents.keys()) dirty.rows.add(name);
  dirty.ground = true;
  ask();
}

export function takeDelta(message) {
  stamp(message);
  if (message.ground) {
    Object.assign(store.ground, message.ground);
    dirty.ground = true;
  }
  for (const [name, change] of Object.entries(message.agents ?? {})) {
    if (change === null) store.agents.delete(name);
    else if (store.agents.has(name)) Object.assign(store.agents.get(name), change);
    else store.agents.set(name, change);
    dirty.rows.add(name);
  }
  ask();
}

export function takePing(message) {
  stamp(message);
}

export function takeEvents(message) {
  const found = (message.events ?? []).filter((event) => event.words);
  if (!found.length) return;
  store.events.push(...found);
  if (store.events.length > MAX_EVENTS) store.events.splice(0, store.events.length - MAX_EVENTS);
  dirty.events.push(...found);
  if (dirty.events.length > MAX_EVENTS) dirty.events.splice(0, dirty.events.length - MAX_EVENTS);
  ask();
}

export function takeRequests(message) {
  for (const request of message.requests ?? []) store.requests.set(request.id, request);
  while (store.requests.size > 100) store.requests.delete(store.requests.keys().next().value);
  dirty.requests = true;
  ask();
}

/** link: "connecting", "live", "down" or "login". */
export function setLink(link) {
  if (store.link === link) return;
  store.link = link;
  store.since = performance.now();
  dirty.link = true;
  ask();
}

function ask() {
  if (asked) return;
  asked = true;
  // A hidden page has no frames; its title and its bell still follow.
  if (document.hidden) setTimeout(flush, 100);
  else requestAnimationFrame(flush);
}

function flush() {
  asked = false;
  const changed = dirty;
  dirty = { rows: new Set(), ground: false, events: [], requests: false, link: false };
  if (changed.link) notify("link");
  if (changed.ground) notify("ground");
  if (changed.rows.size) notify("rows", changed.rows);
  if (changed.events.length) notify("events", changed.events);
  if (changed.requests) notify("requests");
}

function notify(kind, value) {
  for (const watcher of watchers[kind]) watcher(value);
}

// Ages count up: those that show one look four times a second and change only what differs.
setInterval(() => requestAnimationFrame(() => notify("tick")), 250);
document.addEventListener("visibilitychange", () => asked && flush());
