// Sends the saved file to its agent over IP, after a question, and shows the agent's answer.

import { Refused, postJson } from "../api.js";

const LIMIT_MS = 120000;
const DOES = "The agent validates it, replaces its own, and reloads: all units are STALE until their next check.";

/** state: `name`, `version`, `agents`, `agentBase` (version that the agent should have). Returns the answer; `ok` false if not asked. */
export async function deliver(state, status) {
  const agent = state.agents[state.name];
  if (!window.confirm(`Deliver ${state.name} to ${agent}? ${DOES}`)) return { ok: false, problems: [] };
  let got = await send(state, status, state.agentBase);
  if (!got.ok && got.present && got.present !== state.agentBase && got.present !== state.version && got.problems.length === 0) {
    if (window.confirm(`${got.text}. Replace whatever the agent has?`)) got = await send(state, status, null);
  }
  return got;
}

async function send(state, status, base) {
  status.textContent = "delivering...";
  try {
    const got = await postJson("api/config/deliver", { name: state.name, version: state.version, base }, LIMIT_MS);
    status.textContent = `${got.agent || "the agent"}: ${got.text}`;
    return got;
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    status.textContent = error.message;
    return { ok: false, problems: [] };
  }
}
