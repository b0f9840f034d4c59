// The connection to the server: server-sent events, opened again by itself with growing pauses.

import { Refused, openSession, session } from "./api.js";
import { setLink, takeDelta, takeEvents, takeFull, takePing, takeRequests } from "./store.js";

const SILENT_MS = 12000;
const FIRST_MS = 500;
const LONGEST_MS = 5000;

let source = null;
let pause = FIRST_MS;
let receivedAt = 0;
let timer = 0;

/** Open a session and follow the state; again after each failure. */
export async function connect() {
  clearTimeout(timer);
  close();
  try {
    await openSession();
  } catch {
    return lost();
  }
  if (!session.role) return setLink("login");
  receivedAt = performance.now();
  const opened = new EventSource("api/live");
  source = opened;
  const take = (kind, use) =>
    opened.addEventListener(kind, (event) => {
      receivedAt = performance.now();
      if (source === opened) use(JSON.parse(event.data));
    });
  take("full", (message) => {
    pause = FIRST_MS;
    takeFull(message);
    setLink("live");
  });
  take("delta", takeDelta);
  take("events", takeEvents);
  take("requests", takeRequests);
  take("ping", takePing);
  opened.onerror = () => source === opened && lost();
}

/** The session has ended: ask for another one. */
export function checkSession(error) {
  if (error instanceof Refused && error.status === 401) connect();
}

function close() {
  if (source) source.close();
  source = null;
}

function lost() {
  close();
  setLink("down");
  clearTimeout(timer);
  // Spread, so that many pages do not return at the same moment.
  timer = setTimeout(connect, pause * (0.8 + 0.4 * Math.random()));
  pause = Math.min(pause * 2, LONGEST_MS);
}

setInterval(() => source && performance.now() - receivedAt > SILENT_MS && lost(), 1000);
addEventListener("online", () => !source && connect());
