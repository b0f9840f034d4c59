"""Beacons that state which nodes they receive, and the check `consensus` over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from phm import api, testing
from phm_checks.consensus import Consensus

A, B, C, D = "/agent_1/a", "/agent_1/b", "/agent_1/c", "/agent_1/d"
ALL = (A, B, C, D)


def beacon(receives: Mapping[str, bool] | None = None, **fields: Any) -> api.BeaconFact:
    """A beacon with heartbeats, of a node that has run for 100 s."""
    views = {name: api.NeighbourFact(alive, 0.3) for name, alive in (receives or {}).items()}
    given: dict[str, Any] = {
        "age_s": 0.1,
        "period_s": 0.2,
        "birth": "w.1",
        "heartbeats": 500,
        "views": views,
        "turns": 100,
    }
    return api.BeaconFact(**{**given, **fields})


def matrix(*names: str, not_received: tuple[tuple[str, str], ...] = ()) -> dict[str, api.BeaconFact]:
    """Nodes that all receive each other, except for the pairs (observer, observed)."""
    return {
        name: beacon({other: (name, other) not in not_received for other in names if other != name}, witness=name)
        for name in names
    }


def both(*pairs: tuple[str, str]) -> tuple[tuple[str, str], ...]:
    return (*pairs, *((there, here) for here, there in pairs))


class Quorum:
    """The check over time, every second."""

    def __init__(self, *names: str, containers: tuple[str, ...] = ("ros_app",), **ros: Any) -> None:
        self.check = Consensus(
            testing.settings(
                containers=[{"name": name} for name in containers],
                ros={"nodes": [{"name": name} for name in names or (A, B, C)], **ros},
            )
        )
        self.clock, self.ros = testing.FakeClock(), testing.FakeRos(nodes=dict.fromkeys(ALL, 1))

    def after(
        self,
        seconds: float,
        beacons: Mapping[str, api.BeaconFact],
        docker: testing.FakeDocker | None = None,
        **ros: Any,
    ) -> api.Result:
        """The result after this state has lasted for this many seconds."""
        more = {} if docker is None else {"docker": docker}
        for _ in range(int(seconds) + 1):
            self.ros.change(beacons=beacons, **ros)
            result = self.check.run(testing.world(clock=self.clock, ros=self.ros, **more))
            self.clock.advance(1.0)
        assert isinstance(result, api.Result)
        return result
