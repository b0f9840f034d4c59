"""The check `network` of a container with two nodes, for the rules about its data path."""

from __future__ import annotations

import threading
from collections.abc import Callable

from phm import api, testing
from phm_checks.network import Network

NET = "swarm_net"
NODES = ("/a/one", "/a/two")
ROWS = tuple(api.ProcessFact(10 + k, 1, "S", 1.0, f"node --name {name[3:]}") for k, name in enumerate(NODES))


class AdvancingClock(testing.FakeClock):
    """A clock whose `wait` advances the time and applies what happens in the meantime."""

    def __init__(self) -> None:
        super().__init__()
        self.meanwhile: Callable[[float], None] = lambda seconds: None
        self.waits = 0

    def wait(self, event: threading.Event, timeout_s: float | None) -> bool:
        self.waits += 1
        self.advance(timeout_s or 0.0)
        self.meanwhile(timeout_s or 0.0)
        return event.is_set()


class DataPath:
    """A container with two nodes whose beacons are received; the check has seen this container generation."""

    def __init__(self, *, address: bool = True) -> None:
        """address: whether the check pings the container."""
        self.clock = AdvancingClock()
        fact = testing.container("ros_app", networks=(api.Attachment(NET, "id-1", "172.20.0.3"),))
        self.docker = testing.FakeDocker(fact, networks={NET: "id-1"})
        self.docker.lists["ros_app"] = ROWS
        self.ros = testing.FakeRos(up_s=60.0, age_s=0.0)
        self.receive(0.1, 0.2)
        made = testing.settings(
            containers=[{"name": "ros_app", "networks": [NET], "address": address}],
            ros={"nodes": [{"name": name} for name in NODES]},
        )
        (self.check,) = Network.build(made)
        assert self.observe().level is api.Level.OK

    def receive(self, *ages_s: float) -> None:
        beacons = {name: api.BeaconFact(age_s, 0.2) for name, age_s in zip(NODES, ages_s, strict=False)}
        self.ros.change(nodes=dict.fromkeys(NODES, 1), beacons=beacons)

    def observe(self) -> api.Result:
        result = self.check.run(testing.world(docker=self.docker, ros=self.ros, clock=self.clock))
        assert isinstance(result, api.Result)
        return result

    def later(self, seconds: float, *ages_s: float) -> api.Result:
        self.clock.advance(seconds)
        self.receive(*ages_s)
        return self.observe()
