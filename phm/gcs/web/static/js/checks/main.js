// The Checks page: opens a configuration, has the server apply and check each change, and saves or downloads the result.

import { Refused, getJson, login, mayOperate, openSession, postJson, session } from "../api.js";
import { confirmed } from "../confirm.js";
import { byId, el } from "../dom.js";
import { deliver } from "./deliver.js";
import { Form } from "./form.js";
import { commands, showContainers, showDiff, showProblems, showUnits } from "./panels.js";

const MAX_BYTES = 262144;
const MAX_UNDO = 100;
const LIMIT_MS = 60000; // a large file is validated with each change, on a computer that may be busy
const state = { name: "agent.yaml", version: null, base: "", text: "", problems: [], undo: [], yamlChanged: false, agents: {}, agentBase: null, delivering: false };
let form = null;
let queue = Promise.resolve();

function say(text) {
  byId("notice").textContent = text;
  byId("notice").hidden = text === "";
}

/** One request after the other, so that each edit is made in the text that the last one left. Returns whether it was applied. */
function change(edits, rebuild) {
  const done = queue.then(() => apply(state.text, edits, rebuild));
  queue = done.catch(() => false);
  return queue;
}

async function apply(text, edits, rebuild, keep = true) {
  let got;
  try {
    got = await postJson("api/config/check", { name: state.name, text, base: state.base, edits, variables: variables() }, LIMIT_MS);
  } catch (error) {
    if (error instanceof Refused && error.status === 401) await begin();
    say(error instanceof Refused ? error.message : "the page failed");
    if (!(error instanceof Refused)) throw error;
    return false;
  }
  say(got.refused);
  if (keep && got.text !== state.text) state.undo = [...state.undo, state.text].slice(-MAX_UNDO);
  state.text = got.text;
  show(got, rebuild);
  return got.refused === "";
}

function show(got, rebuild) {
  if (!state.yamlChanged) byId("yaml").value = got.text;
  byId("form").inert = !got.usable;
  if (got.usable && rebuild) form.show(got.values);
  else if (got.usable) form.update(got.values);
  showFound(got.problems);
  showUnits(got.units);
  showContainers(got.values);
  showDiff(got.diff);
  showState();
}

function showFound(problems) {
  state.problems = problems;
  form.mark(problems);
  showProblems(problems, (key) => form.reveal(key));
}

function showState() {
  const changed = state.text !== state.base;
  byId("undo").disabled = state.undo.length === 0;
  byId("save").disabled = state.version === null || !changed;
  const agent = state.agents[state.name];
  byId("deliver-ip").hidden = state.version === null || !agent;
  byId("deliver").disabled = changed || state.delivering;
  byId("deliver").textContent = changed ? "Save it first, then deliver" : `Deliver to ${agent}`;
  const count = state.problems.length;
  const quality = count === 0 ? "valid" : `${count} problem${count === 1 ? "" : "s"}`;
  byId("state").textContent = `${state.name}: ${changed ? "changed, not saved" : "not changed"}, ${quality}`;
  byId("commands").textContent = commands(state.name, byId("host").value, byId("target").value, byId("container").value);
}

function load(name, text, version) {
  Object.assign(state, { name, text, base: text, version, undo: [], yamlChanged: false });
  form.show({});
  return apply(text, [], true, false);
}

async function openFile(name) {
  const got = await postJson("api/config/open", { name }, LIMIT_MS);
  state.agentBase = got.version;
  byId("delivered").textContent = "";
  await load(got.name, got.text, got.version);
}

async function save() {
  await settled();
  const body = { name: state.name, text: state.text, version: state.version, variables: variables() };
  if (state.problems.length) {
    const words = `The configuration has ${state.problems.length} problem(s); an agent would refuse it.`;
    body.anyway = await confirmed(["Save it anyway?"], [el("p", { text: words })], "Yes, save");
    if (!body.anyway) return;
  }
  const got = await postJson("api/config/save", body, LIMIT_MS);
  Object.assign(state, { version: got.version, base: state.text });
  await apply(state.text, [], false, false);
  byId("state").textContent = `${state.name}: saved`;
}

/** Problems that only the agent finds are shown at the fields, like all others. */
async function deliverNow() {
  await settled();
  const { name, version } = state;
  state.delivering = true;
  showState();
  try {
    const got = await deliver(state, byId("delivered"));
    if (state.name !== name) return;
    if (got.ok) state.agentBase = version;
    else if (got.problems.length) showFound(got.problems);
  } finally {
    state.delivering = false;
    showState();
  }
}

function variables() {
  const pairs = byId("variables").value.split("\n").map((line) => /^\s*([A-Za-z_]\w*)=(.*)$/.exec(line)).filter((one) => one);
  return Object.fromEntries(pairs.map((one) => [one[1], one[2]]));
}

async function download() {
  await settled();
  const url = URL.createObjectURL(new Blob([state.text], { type: "application/yaml" }));
  const link = el("a", { href: url, download: state.name.split(/[\\/]/).at(-1) });
  link.click();
  URL.revokeObjectURL(url);
}

async function upload(file) {
  if (!file) return;
  if (file.size > MAX_BYTES) throw new Refused(`the file is larger than ${MAX_BYTES / 1024} KiB`, 0);
  byId("file").value = "";
  await load(file.name, await file.text(), null);
}

/** After the edits that are under way: a click on Save also ends the input in a field. */
async function settled() {
  await queue;
}

/** Shows why something failed instead of leaving it in the console. */
function trying(what) {
  return async (event) => {
    event?.preventDefault();
    try {
      await what(event);
    } catch (error) {
      say(error instanceof Refused ? error.message : `the page failed: ${error.message}`);
    }
  };
}

function listen() {
  byId("file").addEventListener("change", trying(() => (byId("file").value ? openFile(byId("file").value) : load("agent.yaml", "", null))));
  byId("upload").addEventListener("change", trying(() => upload(byId("upload").files[0])));
  byId("save").addEventListener("click", trying(save));
  byId("download").addEventListener("click", trying(download));
  byId("deliver").addEventListener("click", trying(deliverNow));
  byId("undo").addEventListener("click", trying(async () => {
    await settled();
    if (state.undo.length) await apply(state.undo.pop(), [], true, false);
  }));
  byId("yaml").addEventListener("input", () => { state.yamlChanged = true; });
  byId("apply").addEventListener("click", trying(async () => {
    await settled();
    state.yamlChanged = false;
    return apply(byId("yaml").value, [], true);
  }));
  byId("variables").addEventListener("change", trying(() => apply(state.text, [], false)));
  byId("host").addEventListener("input", showState);
  byId("target").addEventListener("input", showState);
  byId("container").addEventListener("input", showState);
  byId("copy").addEventListener("click", trying(() => navigator.clipboard.writeText(byId("commands").textContent)));
  byId("login").addEventListener("submit", trying(async () => {
    await login(byId("token").value);
    byId("token").value = "";
    await begin();
  }));
  window.addEventListener("beforeunload", (event) => {
    if (state.text !== state.base) event.preventDefault();
  });
}

async function begin() {
  await openSession();
  byId("login").hidden = !session.login;
  byId("editor").hidden = !mayOperate();
  if (!mayOperate()) return say(session.login ? "" : "Configurations need the role operate.");
  const about = await getJson("api/config");
  if (!about.edit) {
    byId("editor").hidden = true;
    return say("Configurations cannot be edited here.");
  }
  if (form) return say("");
  state.agents = about.agents;
  form = new Form(byId("form"), await getJson("api/config/schema"), change);
  byId("file").append(...about.files.map((name) => el("option", { value: name, text: name })), el("option", { value: "", text: "a new configuration" }));
  return about.files.length ? openFile(about.files[0]) : load("agent.yaml", "", null);
}

const theme = localStorage.getItem("phm-theme");
if (theme === "light" || theme === "dark") document.documentElement.dataset.theme = theme;
listen();
trying(begin)();
