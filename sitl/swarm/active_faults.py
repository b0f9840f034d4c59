"""Faults injected from the command line: remembered beside the swarm, so that another command can clear them."""

from __future__ import annotations

import json
from typing import Any

from sitl.faults import _inject_note, all_faults
from sitl.faults.base import Fault
from sitl.swarm.swarm import Swarm


def inject(swarm: Swarm, number: int, name: str) -> tuple[Fault, str]:
    """Inject one fault into one agent, with a note in its log: the fault, and why there is no note (empty: there is one).

    LookupError names what is not there.
    """
    faults = all_faults()
    if name not in faults:
        raise LookupError(f"there is no fault {name!r}: `python -m sitl inject` lists them")
    if not 1 <= number <= len(swarm.agents):
        raise LookupError(f"there is no agent {number}: allowed are 1 to {len(swarm.agents)}")
    agent, fault = swarm.agents[number - 1], faults[name]
    if len(swarm.agents) < fault.least:
        raise LookupError(f"{name} needs at least {fault.least} agents, the swarm has {len(swarm.agents)}")
    fault.prepare(agent)
    if changes := fault.configuration(agent):
        swarm.configure(agent, changes)
        swarm.wait_healthy()
    _write(swarm, [*_read(swarm), {"fault": name, "agent": number, "knows": {}, "configured": bool(changes)}])
    no_note = _inject_note.write(fault, agent)
    fault.inject(agent)
    _write(swarm, [*_read(swarm)[:-1], {**_read(swarm)[-1], "knows": _plain(vars(fault))}])
    return fault, no_note


def clear(swarm: Swarm, number: int | None = None) -> list[str]:
    """Undo what `inject` has done, newest first, in one agent or in all; what that was. The links are reset anyway."""
    entries, cleared = _read(swarm), []
    for entry in reversed(entries):
        if number not in (None, entry["agent"]):
            continue
        agent, fault = swarm.agents[entry["agent"] - 1], all_faults()[entry["fault"]]
        vars(fault).update(entry["knows"])
        fault.clear(agent)
        if entry["configured"]:
            swarm.configure(agent, {})
        fault.dismantle(agent)
        cleared.append(f"{fault.name} in agent {agent.number}")
    for agent in swarm.agents:
        if number in (None, agent.number):
            swarm.air.reset(agent.number)
    if number is None:
        swarm.air.split([])
    _write(swarm, [entry for entry in entries if number not in (None, entry["agent"])])
    return cleared


def _read(swarm: Swarm) -> list[dict[str, Any]]:
    try:
        found: list[dict[str, Any]] = json.loads((swarm.folder / "injected.json").read_text("utf-8"))
    except FileNotFoundError:
        return []
    return found


def _write(swarm: Swarm, entries: list[dict[str, Any]]) -> None:
    (swarm.folder / "injected.json").write_text(json.dumps(entries, indent=2) + "\n", "utf-8")


def _plain(knows: dict[str, Any]) -> dict[str, Any]:
    """What a fault remembers of its injection, as far as a file can hold it."""
    return {key: value for key, value in knows.items() if isinstance(value, str | int | float | bool | list)}
