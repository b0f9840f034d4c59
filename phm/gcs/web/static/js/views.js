// The swarm's own view beside the ground's: what the leader's digest says, which agents receive each other, and where the two differ.

import { byId, el, render, said, setText } from "./dom.js";
import { ageOf, on, store } from "./store.js";
import { ago, order, received, stateClass } from "./words.js";

const MATRIX_MOST = 24;
let visible = false;

export function startViews() {
  const area = byId("view-views");
  area.append(el("h2", { text: "The ground's view and the swarm's" }), el("div", { id: "v-head" }), el("div", { id: "v-table", class: "scroll", tabindex: "0" }),
    el("div", { id: "v-matrix", class: "scroll", tabindex: "0" }));
  on("rows", () => visible && show());
  on("ground", () => visible && show());
  on("link", () => visible && show());
  on("tick", () => visible && ages());
}

export function showViews(shown) {
  visible = shown;
  if (shown) show();
}

function show() {
  const agents = [...store.agents.values()].sort(order);
  const ground = store.ground;
  render(byId("v-head"), [ground.swarm, ground.links, ground.stations, ground.problems, ground.radios, ground.refused, ground.frames_refused], () => head(ground));
  render(byId("v-table"), agents.map((agent) => [agent.name, agent.how, agent.swarm_says, agent.received_by, agent.not_received_by, agent.receives_ground]), () => table(agents));
  render(byId("v-matrix"), agents.map((agent) => [agent.agent, agent.view?.peers]), () => matrix(agents));
  ages();
}

function ages() {
  for (const node of byId("view-views").querySelectorAll("[data-at]")) setText(node, ago(ageOf(node.dataset.at === "" ? null : Number(node.dataset.at))));
}

function head(ground) {
  const swarm = ground.swarm;
  const at = swarm?.line_at ?? swarm?.digest_at ?? "";
  const radio = (one) => `radio of ${one.link}: signal ${one.rssi ?? "?"}, noise ${one.noise ?? "?"}; other end: signal ${one.remrssi ?? "?"}, noise ${one.remnoise ?? "?"}; `;
  return [
    el("p", { class: "big" }, swarm ? said(swarm.line ?? `${swarm.alive} of ${swarm.members} alive`) : "The swarm's leader has sent no digest.",
      swarm ? el("span", { class: "quiet" }, ` by A${String(swarm.by).padStart(2, "0")}, `, el("span", { "data-at": at })) : null),
    el("ul", { class: "plain" },
      ...(ground.links ?? []).map((link) => el("li", { class: link.open ? "" : "g-error" }, said(`link ${link.link}: ${link.open ? "open" : `CLOSED: ${link.error}`}`))),
      ...(ground.radios ?? []).map((one) => el("li", {}, said(radio(one)), el("span", { "data-at": one.at }))),
      ...(ground.stations ?? []).map((one) => el("li", { text: `other ground station: ${one.system}/${one.component}` })),
      ...(ground.problems ?? []).map((text) => el("li", { class: "g-warn" }, said(`problem: ${text}`))),
      ground.frames_refused ? el("li", { class: "g-warn", text: `${ground.frames_refused} frames above the rate limit dropped` }) : null,
      ground.refused ? el("li", { class: "g-warn", text: `${ground.refused} agents beyond the limit refused` }) : null),
  ];
}

/** How the two views of an agent differ, in words; empty: they agree, or one of them is not there. */
function difference(agent) {
  if (!received(agent) && agent.received_by?.length) return "the swarm receives it, the ground does not";
  if (!received(agent) && agent.swarm_says) return `the ground does not receive it, the swarm says ${agent.swarm_says}`;
  if (received(agent) && !agent.received_by?.length && agent.not_received_by?.length) return "the ground receives it, the swarm does not";
  if (received(agent) && agent.swarm_says && agent.swarm_says !== agent.how) return "the levels differ";
  if (received(agent) && agent.receives_ground === false) return "it does not receive the ground";
  return "";
}

function names(numbers) {
  return numbers?.length ? numbers.map((number) => `A${String(number).padStart(2, "0")}`).join(" ") : "–";
}

function table(agents) {
  const head = ["Agent", "Ground says", "Swarm says", "Difference", "Received by", "Not received by"];
  return el("table", { class: "views" }, el("caption", { class: "hidden", text: "What the ground and the swarm say about each agent" }),
    el("thead", {}, el("tr", {}, ...head.map((text) => el("th", { scope: "col", text })))),
    el("tbody", {}, ...agents.map((agent) => {
      const words = difference(agent);
      return el("tr", { class: words ? "differs" : "" }, el("th", { scope: "row" }, el("a", { href: `#/agent/${encodeURIComponent(agent.name)}`, text: agent.name })),
        el("td", {}, el("span", { class: `state ${stateClass(agent.how)}`, text: agent.how })),
        el("td", {}, agent.swarm_says ? el("span", { class: `state ${stateClass(agent.swarm_says)}`, text: agent.swarm_says }) : "–"),
        el("td", {}, words ? el("strong", { text: `≠ ${words}` }) : "–"), el("td", { text: names(agent.received_by) }), el("td", { text: names(agent.not_received_by) }));
    })));
}

const MARKS = { alive: ["ok", "OK"], late: ["warn", "late"], lost: ["error", "lost"] };

function matrix(agents) {
  const seeing = agents.filter((agent) => agent.view?.peers).sort((left, right) => left.agent - right.agent);
  if (!seeing.length) return [];
  const title = el("h3", { text: "Which agents receive each other" });
  if (agents.length > MATRIX_MOST) return [title, el("p", { text: `Not shown: there are ${agents.length} agents, and room for ${MATRIX_MOST}.` })];
  const numbers = [...new Set(agents.map((agent) => agent.agent))].sort((left, right) => left - right);
  const name = (number) => `A${String(number).padStart(2, "0")}`;
  return [title, el("table", { class: "matrix" }, el("caption", { text: "Rows: the agent that reports. Columns: the agent it reports about." }),
    el("thead", {}, el("tr", {}, el("th", { scope: "col", text: "Agent" }), ...numbers.map((number) => el("th", { scope: "col", text: name(number) })))),
    el("tbody", {}, ...seeing.map((agent) => el("tr", {}, el("th", { scope: "row", text: agent.name }), ...numbers.map((number) => {
      const [mark, text] = MARKS[agent.view.peers[number]] ?? ["none", number === agent.agent ? "self" : "–"];
      return el("td", {}, el("span", { class: `slot ${mark}`, text }));
    })))))];
}
