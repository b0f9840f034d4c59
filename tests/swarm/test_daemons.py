"""Five real daemons on sockets of this machine: heartbeats, views and digests by UDP, with a split, an agent without a
GCS, a restart and a duplicate id.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from phm.facts.swarm import SwarmFact
from phm.runtime.daemon import Daemon
from phm.runtime.wiring import build_daemon
from phm.testing import settings
from phm.wire import tunnel
from tests.fakes.mesh import Mesh
from tests.fakes.until import until

IDS = (1, 2, 3, 4, 5)
ALL = frozenset(f"a{number}" for number in IDS)
BUDGET = 3170
OFF = ("host", "engine", "path", "autopilot", "radio")


class Fleet:
    """Agents 1 to 5, and optionally another one that claims to be agent 3."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.mesh = folder, Mesh([*sorted(ALL), "clone"])
        self.daemons: dict[str, Daemon] = {}
        for number in IDS:
            self.start(f"a{number}", number)

    def start(self, name: str, number: int, off: tuple[str, ...] = OFF) -> None:
        place = self.folder / name
        made = settings(
            agent={"id": number},
            interval=5,
            state_dir=str(place / "state"),
            run_dir=str(place / "run"),
            log={"directory": str(place / "log")},
            swarm={"agents": list(IDS)},
            checks={check: {"enabled": False} for check in off},
            mavlink={
                "endpoints": [{"url": self.mesh.url(name), "name": "mesh", "budget": BUDGET}],
                "heartbeat": 0.5,
                "refresh": 3,
                "gcs_timeout": 2,
            },
        )
        self.daemons[name] = build_daemon(made)
        self.daemons[name].start()

    def stop(self, name: str) -> None:
        self.daemons.pop(name).stop()

    def close(self) -> None:
        for name in list(self.daemons):
            self.stop(name)
        self.mesh.close()

    def sees(self, name: str) -> SwarmFact:
        return self.daemons[name].components.probes.world.swarm.snapshot()

    def states(self, name: str) -> dict[int, str]:
        return {agent: peer.state for agent, peer in self.sees(name).peers.items()}

    def all_ok(self) -> bool:
        return all(set(self.states(name).values()) <= {"alive", "late"} for name in sorted(ALL)) and not any(
            self.sees(name).no_gcs or self.sees(name).duplicate_ids for name in ALL
        )

    def until(self, wanted: Callable[[], Any], what: str) -> None:
        until(wanted, what, lambda: ({name: self.states(name) for name in self.daemons}, self.mesh.lines[-12:]))

    def read(self, text: str, *, by: int | None = None) -> bool:
        """Whether the ground has received this line from that agent."""
        return any(line == text and by in (None, sender) for sender, line in list(self.mesh.lines))


@pytest.fixture(scope="module")
def swarm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleet]:
    made = Fleet(tmp_path_factory.mktemp("swarm"))
    yield made
    made.close()


@pytest.fixture
def fleet(swarm: Fleet) -> Fleet:
    """All five running and OK, whatever the previous test has done."""
    swarm.mesh.apart, swarm.mesh.no_gcs = (), frozenset()
    swarm.until(swarm.all_ok, "all agents to be OK")
    swarm.mesh.lines.clear()
    swarm.mesh.payloads.clear()
    return swarm


def test_a_restarted_agent_leaves_and_returns(fleet: Fleet) -> None:
    """It announces its shutdown, so it is not lost. After its return it is alive, and not a duplicate id."""
    fleet.stop("a2")
    fleet.until(lambda: fleet.states("a5")[2] == "left", "agent 2 to leave")
    assert fleet.sees("a5").members == 4
    fleet.start("a2", 2)
    fleet.until(fleet.all_ok, "agent 2 to be back")


def test_all_receive_each_other_and_one_leads(fleet: Fleet) -> None:
    """Views are exchanged, so each agent knows which agents receive each other; the leader's digest has the status of
    all.
    """
    fleet.until(
        lambda: all(set(peer.received_by) == set(IDS) for name in ALL for peer in fleet.sees(name).peers.values()),
        "views",
    )
    fleet.until(lambda: {fleet.sees(name).leader for name in ALL} == {1}, "agent 1 to be elected")
    fleet.mesh.lines.clear()

    def alone() -> bool:
        """It sends the line twice, and no other agent one. On a busy machine one that does not receive it may lead, too."""
        said = [(sender, line) for sender, line in list(fleet.mesh.lines) if line.startswith("SWARM")]
        if {sender for sender, _ in said} - {1}:
            fleet.mesh.lines.clear()
            return False
        return said.count((1, "SWARM 5/5 OK")) >= 2

    fleet.until(alone, "the line of the swarm")

    def digested() -> bool:
        read = [(sender, tunnel.decode(payload)) for sender, payload in list(fleet.mesh.payloads)]
        return any(
            isinstance(payload_, tunnel.SwarmDigest) and (sender, payload_.alive) == (1, 5) for sender, payload_ in read
        )

    fleet.until(digested, "the digest")


def test_an_agent_that_the_ground_does_not_reach_is_reported_by_its_peers(fleet: Fleet) -> None:
    """Its own messages do not arrive; the leader reports which agents receive it and its state."""
    fleet.mesh.no_gcs = frozenset({"a3"})
    fleet.until(lambda: fleet.sees("a1").no_gcs == (3,), "the agent without a GCS")
    fleet.until(lambda: fleet.read("A03 no GCS radio, received by A01 A02 A04 A05: OK", by=1), "the relayed line")


def test_both_sides_of_a_split_detect_it_and_it_ends(fleet: Fleet) -> None:
    """Each side reports the other as lost and the split, and has a leader; reconnected they are one swarm."""
    fleet.mesh.apart = (frozenset({"a1", "a2"}), frozenset({"a3", "a4", "a5"}))
    fleet.until(lambda: fleet.sees("a1").split == (3, 4, 5) and fleet.sees("a5").split == (1, 2), "the split")
    fleet.until(lambda: fleet.read("SWARM 2/5 FAIL A03:lost A04:lost A05:lost", by=1), "one side's line")
    fleet.until(lambda: fleet.read("SWARM 3/5 FAIL A01:lost A02:lost", by=3), "the other side's line")
    fleet.mesh.apart = ()
    fleet.until(fleet.all_ok, "the swarm to be complete")


def test_two_agents_with_one_id_are_detected(fleet: Fleet) -> None:
    """By the others, from the sequence numbers, however close these are; by both of them, who receive their own
    identity.
    """
    fleet.start("clone", 3, off=OFF[1:])
    fleet.until(lambda: fleet.sees("a1").duplicate_ids == fleet.sees("a5").duplicate_ids == (3,), "the clash")
    for name in ("a3", "clone"):
        problems = fleet.daemons[name].components.probes.world.links.problems  # type: ignore[attr-defined]
        fleet.until(lambda ask=problems: any("another program" in words for words in ask()), f"{name} to notice")
    fleet.stop("clone")
