// Requests to the server. Each has a deadline; a failure is a sentence.

const LIMIT_MS = 10000;

export const session = { role: null, csrf: null, login: false, tokens: false, page: "gcs" };

/** What the server refuses, or that it does not answer. */
export class Refused extends Error {
  constructor(message, status) {
    super(message);
    this.status = status;
  }
}

export async function getJson(path, parameters = {}) {
  const given = Object.entries(parameters).filter(([, value]) => value !== "" && value !== null && value !== undefined);
  const query = new URLSearchParams(given).toString();
  return send(query ? `${path}?${query}` : path, {});
}

/** limit: milliseconds until the server must have answered. */
export async function postJson(path, body, limit = LIMIT_MS) {
  const headers = { "Content-Type": "application/json" };
  if (session.csrf) headers["X-PHM-CSRF"] = session.csrf;
  return send(path, { method: "POST", headers, body: JSON.stringify(body) }, limit);
}

/** Who this page is to the server; opens a session where no token is needed. */
export async function openSession() {
  return Object.assign(session, await send("api/session", {}));
}

export async function login(token) {
  return Object.assign(session, await postJson("api/login", { token }));
}

export async function logout() {
  await postJson("api/logout", {});
  return openSession();
}

export function mayOperate() {
  return session.role === "operate";
}

async function send(path, options, limit = LIMIT_MS) {
  let answer;
  try {
    answer = await fetch(path, { ...options, signal: AbortSignal.timeout(limit), cache: "no-store" });
  } catch {
    throw new Refused("the server does not answer", 0);
  }
  let body = {};
  try {
    body = await answer.json();
  } catch {
    body = {};
  }
  if (!answer.ok) throw new Refused(body.error || `the server answered ${answer.status}`, answer.status);
  return body;
}
