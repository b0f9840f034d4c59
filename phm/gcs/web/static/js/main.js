// The page: which part is shown, the connection, the log-in, and the appearance.

import { showAgent, startAgent } from "./agent.js";
import { startActions } from "./actions.js";
import { startAlarms } from "./alarms.js";
import { getJson, login, logout, mayOperate, session } from "./api.js";
import { byId, el, render, setText } from "./dom.js";
import { startEvents } from "./events.js";
import { focusRow, markOpen, startGrid } from "./grid.js";
import { connect } from "./live.js";
import { startReplay } from "./replay.js";
import { on, store } from "./store.js";
import { showViews, startViews } from "./views.js";
import { age, stateClass } from "./words.js";

const GRAVITY = ["ERROR", "LOST", "WARN", "UNKNOWN", "STALE", "HOLD", "BOOT", "LEFT", "OK"];
const THEMES = ["auto", "light", "dark"];
let agent = "";

function route() {
  const [, page = "swarm", name = ""] = location.hash.split("/");
  const login = store.link === "login";
  const before = agent;
  try {
    agent = page === "agent" && !login ? decodeURIComponent(name) : "";
  } catch {
    agent = "";
  }
  const shown = login ? "login" : ["views", "events"].includes(page) ? page : "swarm";
  for (const one of ["login", "swarm", "views", "events"]) byId(`view-${one}`).hidden = one !== shown;
  for (const one of ["swarm", "views", "events"]) {
    if (one === shown) byId(`tab-${one}`).setAttribute("aria-current", "page");
    else byId(`tab-${one}`).removeAttribute("aria-current");
  }
  showViews(shown === "views");
  showAgent(shown === "swarm" ? agent : "");
  markOpen(agent);
  if (before && !agent && shown === "swarm") focusRow(before);
}

function open(name) {
  location.hash = name === agent ? "#/swarm" : `#/agent/${encodeURIComponent(name)}`;
}

function showLink() {
  document.body.dataset.link = store.link;
  const words = { live: "● Live", down: "✕ No connection", connecting: "… connecting", login: "Log in" };
  setText(byId("link"), words[store.link]);
  byId("banner").hidden = store.link !== "down";
  if (store.link === "login") showLogin();
  byId("logout").hidden = !session.role || !session.tokens;
  banner();
  route();
  if (store.link === "live") showChecks();
}

/** The link to the page that edits configurations, where this ground station has some. */
async function showChecks() {
  let edit = false;
  try {
    edit = mayOperate() && (await getJson("api/config")).files.length > 0;
  } catch {
    edit = false;
  }
  byId("tab-checks").hidden = !edit;
}

function banner() {
  if (store.link !== "down") return;
  // The sentence stays the same, so that a screen reader reads it once; the time is beside it.
  const seconds = (performance.now() - store.since) / 1000;
  render(byId("banner"), "down", () => [el("strong", { text: "No connection to the server. " }),
    "The data shown are old, and their age is unknown. The page reconnects by itself. ", el("span", { id: "down-for", "aria-hidden": "true" })]);
  setText(byId("down-for"), age(seconds));
}

function showLogin() {
  render(byId("view-login"), "login", () => {
    const token = el("input", { id: "token", type: "password", autocomplete: "current-password", required: true });
    const problem = el("p", { class: "problem", role: "alert" });
    const submit = async (event) => {
      event.preventDefault();
      try {
        await login(token.value);
        token.value = "";
        setText(problem, "");
        connect();
      } catch (error) {
        setText(problem, error.message);
      }
    };
    return el("form", { on: { submit } }, el("h2", { text: "Log in" }), el("label", { for: "token", text: "Token of this page" }), token,
      el("button", { type: "submit", class: "strong", text: "Log in" }), problem);
  });
}

function showCounts() {
  const found = {};
  for (const one of store.agents.values()) found[one.how] = (found[one.how] ?? 0) + 1;
  render(byId("counts"), found, () => [el("span", { text: `${store.agents.size} agents` }),
    ...GRAVITY.filter((how) => found[how]).map((how) => el("span", { class: `state ${stateClass(how)}`, text: `${found[how]} ${how}` }))]);
}

function showGround() {
  const { page, version, system, component } = store.ground;
  const titles = { gcs: "PHM swarm", status: "PHM agent", replay: "PHM replay" };
  setText(byId("title"), titles[page] ?? "PHM");
  byId("title").title = `PHM ${version ?? ""}${system ? `, ground station ${system}/${component}` : ""}`;
  document.body.dataset.page = page ?? "gcs";
  byId("tab-views").hidden = page === "status";
}

/** An agent's own page has one row: its details are open. */
function openOnly() {
  if (store.ground.page === "status" && store.agents.size === 1 && !location.hash) open([...store.agents.keys()][0]);
}

function theme(next) {
  localStorage.setItem("phm-theme", next);
  if (next === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = next;
  setText(byId("theme"), `Theme: ${next}`);
}

theme(THEMES.includes(localStorage.getItem("phm-theme")) ? localStorage.getItem("phm-theme") : "auto");
byId("theme").addEventListener("click", () => theme(THEMES[(THEMES.indexOf(localStorage.getItem("phm-theme")) + 1) % THEMES.length]));
byId("logout").addEventListener("click", () => logout().finally(connect));
document.addEventListener("keydown", (event) => {
  if (event.key === "Escape" && agent && !byId("dialog").open) location.hash = "#/swarm";
});
document.querySelector(".skip").addEventListener("click", (event) => {
  event.preventDefault();
  byId("main").focus();
});
startGrid(open);
startAgent();
startActions();
startAlarms();
startEvents();
startViews();
startReplay();
on("link", showLink);
on("ground", showGround);
on("rows", () => {
  showCounts();
  openOnly();
});
on("tick", banner);
addEventListener("hashchange", route);
route();
connect();
