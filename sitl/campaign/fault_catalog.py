"""Which faults a campaign can inject, together with which others, and their properties."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from sitl.campaign.plan import Class, Pair
from sitl.campaign.profiles import Profile, beyond_naming
from sitl.campaign.trial import Injection
from sitl.faults.base import Agent, Fault

LEFT_ALONE = ("node_killed", "network_disconnected", "container_stopped")
"""Injected with recovery off: each would be recovered with it."""
OFF = {"\n  mode: act": "\n  mode: off"}
TIMES = 3
"""How often each fault is injected at least, over all seeds."""
EXCLUDED = {
    "overload_ends": "it is injected when it ends, so its times have no meaning here: see sitl.bench.starvation"
}
_PAIRS: Collection[Pair] = (
    ("engine", "container"),
    ("engine", "nodes"),
    ("engine", "files"),
    ("network", "nodes"),
    ("network", "files"),
    ("container", "nodes"),
    ("container", "files"),
    ("nodes", "files"),
    ("topics", "files"),
    ("health", "files"),
    ("load", "nodes"),
    ("load", "network"),
    ("load", "container"),
    ("load", "files"),
    ("host", "nodes"),
    ("host", "network"),
    ("host", "container"),
    ("host", "topics"),
    ("host", "files"),
    ("autopilot", "nodes"),
    ("autopilot", "network"),
    ("autopilot", "container"),
    ("autopilot", "topics"),
    ("autopilot", "files"),
)
"""Kinds that may be on one agent at the same time: each has its own observable end, and its own recovery or none.
Never together: two faults that the same restart recovers, such as those of two nodes; and anything with a fault of PHM or of
the link to the ground, which hides both until it ends.
"""
WANTED: Sequence[Pair] = (("engine", "container"), ("network", "nodes"), ("nodes", "load"), ("container", "nodes"))
"""Pairs that every campaign has to inject."""
EXPLAINS: Mapping[str, frozenset[str]] = {
    "container": frozenset({"nodes", "topics", "health"}),
    "network": frozenset({"topics"}),  # nothing on a network ends a process
}
"""A fault of the kind on the left causes or blocks the symptoms of those on the right, and its recovery may restart them: its
alarm may report both.
"""
THROUGH_ENGINE = frozenset({"container", "files"})
"""Kinds that PHM knows of through the Docker Engine, except what BY_CGROUP lists."""
BY_CGROUP = frozenset({"exited", "oom", "paused"})
"""Conditions that the container's cgroup shows, too: it has no process left, is frozen, or is removed with its container."""
_SOLE = frozenset({"clock_stepped", "memory_leak", "network_lost_together", "phm_killed_in_restart", "power_loss"})
"""Faults that affect PHM as well as what they are named for, or whose injection takes more than a minute."""
_RANK = {
    "load": 0,
    "host": 0,
    "engine": 1,
    "autopilot": 1,
    "files": 2,
    "nodes": 3,
    "topics": 3,
    "health": 3,
    "network": 4,
    "container": 5,
}
"""Of several faults on one agent, the cause is injected last: no node can be killed in a container that does not run."""
_CUT_OFF = ("gcs", "radio", "router")
"""Kinds of faults during which the ground cannot receive the agent, whether its PHM runs or not."""


def kind(fault: Fault) -> str:
    """What fails, for the tables above: the check that reports it, with a few exceptions."""
    special = {"container/router": "router", "host/cpu": "load"}.get(fault.unit)
    check = fault.unit.partition("/")[0]
    return special or ("topics" if check in ("rates", "data") else check or fault.layer)


def class_of(fault: Fault) -> Class:
    """As the plan needs it. A fault of the application that nothing on board can end has no partners: theirs could not end."""
    found = kind(fault)
    lasting = found in ("container", "network", "nodes", "topics", "health") and not (fault.healable or fault.passes)
    # A fault that adds containers or nodes changes what its partners would be.
    entangled = ("configuration" in fault.needs and found not in ("engine", "host")) or fault.name in _SOLE
    partners = frozenset() if lasting or entangled or fault.others else _partners(found)
    return Class(fault.name, found, partners, "alone" in fault.needs or bool(fault.others), _RANK.get(found, 0))


def _partners(found: str) -> frozenset[str]:
    return frozenset(other for pair in _PAIRS if found in pair for other in pair if other != found)


def excluded(faults: Mapping[str, Fault], agents: int, profile: Profile, *, air: bool) -> dict[str, str]:
    """The faults that a campaign with this many agents, with or without emulated links, does not inject, and why."""
    reasons = {name: unsuitable_because(fault, agents, profile, air=air) for name, fault in faults.items()}
    return {name: why for name, why in reasons.items() if why}


def unsuitable_because(fault: Fault, agents: int, profile: Profile, *, air: bool) -> str:
    """Why a fault is excluded; empty if it is not."""
    if fault.name in EXCLUDED:
        return EXCLUDED[fault.name]
    if fault.also:
        return "it is two faults, and a campaign makes compound faults itself"
    if "air" in fault.needs and not air:
        return "it needs emulated links"
    if agents < fault.least:
        return f"it needs {fault.least} agents"
    if not profile.tuned and fault.name in profile.unseen:
        return profile.unseen[fault.name]
    if not profile.tuned and (keys := beyond_naming(fault)):
        return f"the shipped configuration does not set {', '.join(keys)}"
    return ""


def chosen(
    faults: Mapping[str, Fault], only: Collection[str], agents: int, profile: Profile, *, air: bool
) -> dict[str, Fault]:
    """The faults to draw from. Raises ValueError for a requested fault that is not available."""
    unknown = sorted(set(only) - faults.keys())
    if unknown:
        raise ValueError(f"no such fault: {', '.join(unknown)}; there are {', '.join(sorted(faults))}")
    found = {name: fault for name, fault in faults.items() if not only or name in only}
    reasons = excluded(found, agents, profile, air=air)
    if only and reasons:
        raise ValueError("; ".join(f"{name}: {why}" for name, why in reasons.items()))
    return {name: fault for name, fault in found.items() if name not in reasons}


def injection(fault: Fault, agent: Agent, profile: Profile) -> Injection:
    """The record of a fault before its injection."""
    names = {"agent": agent.name, "id": f"A{agent.number:02d}"}
    found = kind(fault)
    return Injection(
        fault=fault.name,
        title=fault.title,
        layer=fault.layer,
        agent=agent.number,
        unit=fault.unit.format(**names),
        condition=fault.condition,
        healable=fault.healable and fault.name not in profile.not_recovered,
        level=fault.level,
        others=fault.others.format(**names),
        earlier=fault.earlier,
        cause=fault.cause,
        group=found,
        blinds=found in _CUT_OFF,
        phm=found == "companion",
        passes=fault.passes,
        also=[unit.format(**names) for unit in fault.also],
        evidence=fault.evidence,
        evidence_s=fault.evidence_s,
        evidence_period_s=fault.evidence_period_s,
        outage_s=fault.outage_s,
    )


def explained(injections: Collection[Injection]) -> None:
    """Fill in `explained_by` and `hidden_s` of a trial's faults, from what is injected beside each on its agent."""
    for each in injections:
        if each.group in THROUGH_ENGINE and each.condition not in BY_CGROUP:
            each.hidden_s = max((it.outage_s for it in injections if it.agent == each.agent), default=0.0)
        causes = [it for it in injections if it.agent == each.agent and each.group in EXPLAINS.get(it.group, ())]
        # The last one injected: a container's end explains more than the loss of its network.
        each.explained_by = max(causes, key=lambda it: _RANK.get(it.group, 0)).fault if causes else ""
