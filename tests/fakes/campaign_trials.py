"""Trials for tests: events with their times, in seconds after the injection at 100."""

from __future__ import annotations

from typing import Any

from sitl.campaign.trial import Act, Alarm, Injection, Line, Trial

T0 = 100.0
NODE = "nodes/agent_3/node_1"


def injection(**more: Any) -> Injection:
    given = {
        "fault": "node_killed",
        "title": "node killed",
        "layer": "ros",
        "agent": 3,
        "unit": NODE,
        "condition": "node_missing",
        "healable": True,
        "group": "app",
        "moment": T0,
        "cleared": T0 + 20,
        "world_seen": True,
        "world_broken": T0,
        "world": T0 + 3.5,
    }
    return Injection(**{**given, **more})


def alarm(after: float, unit: str = NODE, agent: int = 3, **more: Any) -> Alarm:
    given: dict[str, Any] = {"slot": 6, "fault": f"f-{unit}", "conditions": ["node_missing"], "summary": "it is dead"}
    return Alarm(agent, unit, mono=T0 + after, **{**given, **more})


def verified(after: float, unit: str = NODE, agent: int = 3, action: str = "restart") -> Act:
    return Act(agent, unit, action, "verified", T0 + after, "is OK again")


def started(after: float, unit: str = NODE, agent: int = 3, action: str = "restart") -> Act:
    return Act(agent, unit, action, "started", T0 + after, "")


def line(after: float, text: str, system: int = 3) -> Line:
    return Line(system, 2, text, T0 + after)


def trial(**more: Any) -> Trial:
    """A successful one: a node is killed, detected after 0.4 s, on the ground after 0.9 s, recovered after 4 s."""
    given: dict[str, Any] = {
        "injections": [injection()],
        "alarms": [alarm(0.4, closed=T0 + 4, outcome="resolved", by="restart")],
        "acts": [verified(4.0)],
        "lines": [line(0.9, "A03 FAIL 6 node_1 dead")],
        "heartbeats": {agent: [T0 - 2 + 2 * beat for beat in range(22)] for agent in range(1, 9)},
        "healthy_after": 6.0,
        "ended": T0 + 40,
    }
    return Trial(**{"kind": "trial", "number": 1, "agents": 8, "began": T0 - 1, "utc": 1.7e9, **given, **more})
