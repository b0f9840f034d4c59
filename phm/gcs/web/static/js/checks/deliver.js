// Sends the saved file to its agent over IP, after a question, and shows the agent's answer.

import { Refused, postJson } from "../api.js";
import { confirmed } from "../confirm.js";
import { el, said } from "../dom.js";

const LIMIT_MS = 180000; // longer than `phm/gcs/delivery_client.py` waits
const DOES = "The agent validates it, replaces its own, and reloads: all units are STALE until their next check.";

/** state: `name`, `version`, `agents`, `agentBase` (version that the agent should have). Returns the answer; `ok` false if not asked. */
export async function deliver(state, status) {
  const { name, version, agentBase } = state; // another file may be opened meanwhile
  const agent = state.agents[name];
  if (!await confirmed([said(`Deliver ${name} to ${agent}?`)], [el("p", { text: DOES })], "Yes, deliver")) return { ok: false, problems: [] };
  let got = await send(name, version, agentBase, status);
  if (!got.ok && got.present && got.present !== agentBase && got.present !== version && got.problems.length === 0) {
    if (await confirmed(["Replace whatever the agent has?"], [el("p", {}, said(`${got.text}.`))], "Yes, replace")) {
      got = await send(name, version, null, status);
    }
  }
  return got;
}

async function send(name, version, base, status) {
  status.textContent = "delivering...";
  try {
    const got = await postJson("api/config/deliver", { name, version, base }, LIMIT_MS);
    status.textContent = `${got.agent || "the agent"}: ${got.text}`;
    return got;
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    const unknown = error.status === 0 ? "; it is not known whether the configuration was applied: see the agent's log" : "";
    status.textContent = `${error.message}${unknown}`;
    return { ok: false, problems: [] };
  }
}
