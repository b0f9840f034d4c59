"""Which faults a campaign can inject, and their properties. Pure except for reading the available files."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Mapping

from sitl.campaign.plan import Class
from sitl.campaign.trial import Injection
from sitl.faults.base import Agent, Fault
from sitl.faults.file_deleted import CONTENT

LEFT_ALONE = ("node_killed", "network_disconnected", "container_stopped")
"""Injected with recovery off: each would be recovered with it."""
CHANGES = {
    "\n  budget: 5": "\n  budget: 100",
    '#sha256: "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"': f'sha256: "{hashlib.sha256(CONTENT).hexdigest()}"',
    "#restore: image": "restore: image",
}
"""Of the shipped configuration, for all agents: room for many faults in a row, and a file that can be judged and restored."""
OFF = {"\n  mode: act": '\n  mode: "off"'}
"""In quotes, since the swarm's configuration is parsed by a reader for which an unquoted off is false."""
_GROUPS = {
    **dict.fromkeys(("container", "health", "network", "devices", "nodes", "topics", "rates", "consensus"), "app"),
    "files": "files",
    "host": "host",
    "companion": "phm",
}
"""By check. What restarts the application hides and heals all else about it; a file on a volume stays as it is."""
_BESIDE = ("app", "files", "host")
"""Groups of which one each may come together on an agent. A fault of PHM or of its links would change the others' times."""


def group(fault: Fault) -> str:
    return "link" if fault.layer == "link" else _GROUPS.get(fault.unit.partition("/")[0], "link")


def class_of(fault: Fault) -> Class:
    found = group(fault)
    alone = bool({"alone", "configuration"} & fault.needs) or bool(fault.others)
    return Class(fault.name, fault.layer, found, found not in _BESIDE, alone)


def unsuitable_because(fault: Fault, agents: int, *, air: bool) -> str:
    """Why a campaign with this many agents, with or without emulated links, excludes the fault; empty if it does not."""
    if fault.also:
        return "it is two faults, and a campaign makes compound faults itself"
    if "starvation" in fault.needs:
        return "what it starves is reported at the cause alone, which `python -m sitl.bench.starvation` evaluates"
    if "air" in fault.needs and not air:
        return "it needs emulated links"
    if agents < fault.least:
        return f"it needs {fault.least} agents"
    return ""


def chosen(faults: Mapping[str, Fault], only: Collection[str], agents: int, *, air: bool) -> dict[str, Fault]:
    """The faults to draw from. Raises ValueError for a requested fault that is not available."""
    unknown = sorted(set(only) - faults.keys())
    if unknown:
        raise ValueError(f"no such fault: {', '.join(unknown)}; there are {', '.join(sorted(faults))}")
    found = {name: fault for name, fault in faults.items() if not only or name in only}
    reasons = {name: why for name, fault in found.items() if (why := unsuitable_because(fault, agents, air=air))}
    if only and reasons:
        raise ValueError("; ".join(f"{name}: {why}" for name, why in reasons.items()))
    return {name: fault for name, fault in found.items() if name not in reasons}


def injection(fault: Fault, agent: Agent) -> Injection:
    """The record of a fault before its injection."""
    names = {"agent": agent.name, "id": f"A{agent.number:02d}"}
    found = group(fault)
    return Injection(
        fault=fault.name,
        title=fault.title,
        layer=fault.layer,
        agent=agent.number,
        unit=fault.unit.format(**names),
        condition=fault.condition,
        healable=fault.healable,
        level=fault.level,
        others=fault.others.format(**names),
        cause=fault.cause,
        group=found,
        blinds=fault.layer == "link" and not fault.unit.startswith("peers/"),
        phm=fault.layer == "companion" and found == "phm",
        passes=fault.passes,
        also=[unit.format(**names) for unit in fault.also],
    )
