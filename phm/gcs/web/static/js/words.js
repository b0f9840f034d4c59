// Words, symbols and order of what is shown: the same everywhere.

export const SLOTS = Array.from({ length: 15 }, (_, at) => String(at + 1));
const SHORT = ["GCS", "CON", "FIL", "NET", "DEV", "NOD", "TOP", "RAT", "HST", "AUT", "RAD", "PEE", "US1", "US2", "US3"];
const LONG = [
  "ground link", "containers", "files", "network", "devices", "nodes", "topics", "rates", "host", "autopilot", "radio", "peers",
  "user 1", "user 2", "user 3",
];
export const LAYERS = [
  ["companion", "Companion computer", ["1", "9"]],
  ["docker", "Containers", ["2", "3", "4", "5"]],
  ["ros", "ROS 2", ["6", "7", "8"]],
  ["link", "Links", ["10", "11", "12"]],
  ["custom", "User-defined", ["13", "14", "15"]],
];
const CELLS = { OK: ["ok", "OK"], WARN: ["warn", "WARN"], ERROR: ["error", "ERROR"] };

export function slotShort(slot) {
  return SHORT[Number(slot) - 1] ?? slot;
}

export function slotLong(slot) {
  return LONG[Number(slot) - 1] ?? `slot ${slot}`;
}

/** Class and text of the cell of a slot; not received: nothing is known, whatever was reported before. */
export function cell(row, slot) {
  if (!received(row)) return ["lost", "?"];
  return CELLS[row.slots?.[slot]] ?? ["none", "–"];
}

export function received(row) {
  return row.presence === "alive" || row.presence === "late";
}

const STATES = {
  OK: "ok", WARN: "warn", ERROR: "error", LOST: "lost", UNKNOWN: "unknown", STALE: "unknown", HOLD: "info", BOOT: "info", LEFT: "left",
};

/** Class of the state of an agent. */
export function stateClass(how) {
  return STATES[how] ?? "unknown";
}

export const PRESENCE = {
  alive: "received", late: "late", lost: "not received any more", left: "stopped on purpose", "never received": "never received",
};

/** `3 s`, `12 min`, `5 h`, `9 d`; `?` when it is not known. */
export function age(seconds) {
  if (seconds === null || seconds === undefined || Number.isNaN(seconds)) return "?";
  const whole = Math.max(0, Math.floor(seconds));
  if (whole < 60) return `${whole} s`;
  if (whole < 3600) return `${Math.floor(whole / 60)} min`;
  if (whole < 86400) return `${Math.floor(whole / 3600)} h`;
  return `${Math.floor(whole / 86400)} d`;
}

export function ago(seconds) {
  const text = age(seconds);
  return text === "?" ? "at an unknown time" : `${text} ago`;
}

/** Time of day, UTC, of seconds since 1970. */
export function clock(utc) {
  if (utc === null || utc === undefined) return "";
  return new Date(utc * 1000).toISOString().slice(11, 19);
}

export function day(utc) {
  return new Date(utc * 1000).toISOString().slice(0, 10);
}

/** The broken hop in words; empty: none is known. */
export function hopWords(hop) {
  return hop ? `${hop.name}${hop.certain ? "" : "?"}: ${hop.evidence}` : "";
}

/** Class and words for the autopilot of an agent. */
export function autopilotWords(autopilot) {
  if (!autopilot) return ["none", "?"];
  if (autopilot.presence === "lost") return ["error", "LOST"];
  return autopilot.armed ? ["armed", "ARMED"] : ["none", "disarmed"];
}

/** The order of the rows: the worst first. */
export function order(left, right) {
  return left.rank - right.rank || compare(left.name, right.name);
}

export function compare(left, right) {
  return left.localeCompare(right, "en", { numeric: true });
}
