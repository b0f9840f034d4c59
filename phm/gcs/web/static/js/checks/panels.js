// Beside the form: problems, units, changes, and the commands that deliver a file.

import { byId, button, el } from "../dom.js";

const SIGNS = { new: "+ new", gone: "- gone", changed: "* changed" };
const HOST = /^[A-Za-z0-9_][A-Za-z0-9_.-]*@[A-Za-z0-9[][A-Za-z0-9_.:\]-]*$/;
const CONTAINER = /^[A-Za-z0-9][A-Za-z0-9_.-]*$/;
const TARGET = /^\/[A-Za-z0-9_./-]+$/;

export function showProblems(problems, reveal) {
  const list = byId("problems");
  if (problems.length === 0) {
    list.replaceChildren(el("li", { class: "good", text: "None: the configuration is valid." }));
    return;
  }
  list.replaceChildren(...problems.map((one) => {
    const where = [one.line ? `line ${one.line}` : "", one.key].filter(Boolean).join(", ");
    const place = one.key ? button(where, () => reveal(one.key), { class: "link" }) : el("span", { text: where });
    return el("li", {}, place, el("span", { text: ` ${one.message}` }));
  }));
}

export function showUnits(units) {
  const here = units.filter((row) => row.change !== "gone");
  const fresh = units.filter((row) => row.change === "new").length;
  byId("units-count").textContent = units.length ? `${here.length}${fresh ? `, ${fresh} new` : ""}` : "when the configuration is valid";
  const sorted = [...units].sort((one, two) => Boolean(two.change) - Boolean(one.change));
  byId("units").replaceChildren(...sorted.map((row) => el("tr", { class: row.change },
    el("th", { scope: "row", text: row.unit }),
    el("td", { text: row.slot }),
    el("td", { text: row.needs.join(", ") || "nothing" }),
    el("td", { text: SIGNS[row.change] || "" }))));
  names("names-units", units.map((row) => row.unit));
  names("names-checks", [...new Set(units.map((row) => row.check))]);
}

export function showContainers(values) {
  const entries = Array.isArray(values.containers) ? values.containers : [];
  names("names-containers", entries.map((one) => one?.alias || one?.name).filter((one) => typeof one === "string"));
}

export function showDiff(diff) {
  const lines = diff ? diff.split("\n") : [];
  const changed = lines.slice(2).filter((line) => /^[+-]/.test(line)).length;
  byId("diff-count").textContent = changed ? `${changed} lines` : "none";
  byId("diff").replaceChildren(...lines.map((line) => el("span", { class: kindOf(line), text: `${line}\n` })));
}

function kindOf(line) {
  if (line.startsWith("@@") || line.startsWith("---") || line.startsWith("+++")) return "hunk";
  return line.startsWith("+") ? "added" : line.startsWith("-") ? "removed" : "";
}

/**
 * Commands for a shell: the agent validates the new file, keeps the old one as .bak, and reloads. container: of PHM, empty without.
 * Nothing that a shell would interpret gets into them. The file is written in place: it may be mounted into a container.
 */
export function commands(name, host, target, container) {
  const file = name.split(/[\\/]/).at(-1).replace(/[^A-Za-z0-9_.-]/g, "_").replace(/^-+/, "") || "agent.yaml";
  if (!HOST.test(host)) return "Enter the agent as USER@HOST.";
  if (!TARGET.test(target)) return "Enter the absolute path of its configuration: letters, digits, '_', '.', '-' and '/'.";
  if (container && !CONTAINER.test(container)) return "Enter the name of PHM's container: letters, digits, '_', '.' and '-'.";
  const next = `${target}.new`;
  const inside = `docker exec -i ${container} sh -c 'cat > /tmp/phm-new.yaml && phm validate /tmp/phm-new.yaml' < ${next}`;
  const validate = container ? inside : `phm validate ${next}`;
  const reload = container ? `docker exec ${container} phm reload` : "phm reload";
  const replace = `cp -p ${target} ${target}.bak && cp ${next} ${target}`;
  return [`scp ./${file} ${host}:${next}`, `ssh ${host} "${validate} && ${replace} && ${reload}"`].join("\n");
}

function names(id, words) {
  byId(id).replaceChildren(...words.slice(0, 500).map((word) => el("option", { value: word })));
}
