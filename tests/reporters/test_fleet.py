"""What the reporter publishes and when, with a link that keeps it and a clock that the test moves."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from phm.cli import terminal
from phm.core.model import Level, Outcome, Report, Slot, UnitState
from phm.core.settings import Settings
from phm.reporters.fleet import AGAIN_S, ALONG_S, FleetReporter
from phm.testing import FakeClock
from phm.transport.zenoh_link import FleetFact
from tests.fakes.records import at, closed, context, fault, opened, transition, unit

HEALTHY = unit("container/ros_app", Slot.CONTAINER)
DEAD = unit("nodes/a/one", Slot.NODES, Level.ERROR, brief="one dead", condition="gone", fault="ab12-1")
CONNECTED = FleetFact(True, 100.0, "", 3, 1, 900, 1, ())


class Link:
    """Keeps what is published."""

    def __init__(self) -> None:
        self.put_: list[dict[str, Any]] = []
        self.is_present: bool | None = None
        self.started = False
        self.last: dict[str, Any] = {}
        self.state = CONNECTED

    def start(self) -> None:
        self.started = True

    def put(self, payload: bytes) -> None:
        self.put_.append(json.loads(payload))

    def present(self, yes: bool) -> None:
        self.is_present = yes

    def fact(self) -> FleetFact:
        return self.state

    def close(self, last: bytes = b"") -> None:
        self.last = json.loads(last)


class Bench:
    def __init__(self, states: Sequence[UnitState] = (HEALTHY,), **parts: Any) -> None:
        self.clock, self.link, self.alive, self.states = FakeClock(), Link(), True, tuple(states)
        self.settings = Settings.model_validate(
            {
                "agent": {"name": "agent_3", "id": 3},
                "fleet": {"enabled": True, "name": "north", "connect": ["tcp/r:7447"]},
            }
        )
        made = context(self.settings, clock=self.clock, states=lambda: self.states, alive=lambda: self.alive)
        self.fleet = FleetReporter(replace(made, **parts), self.link)

    @property
    def last(self) -> dict[str, Any]:
        return self.link.put_[-1]


def test_no_reporter_exists_when_it_is_disabled() -> None:
    """By default there is no such reporter, and Zenoh is not imported."""
    assert FleetReporter.build(context(Settings())) is None


def test_the_state_is_published_immediately_and_refreshed() -> None:
    """The first tick publishes; the next when the refresh is due; the sequence number continues."""
    bench = Bench()
    bench.fleet.tick()
    bench.fleet.tick()
    assert [entry["seq"] for entry in bench.link.put_] == [1]
    bench.clock.advance(bench.settings.fleet.refresh)
    bench.fleet.tick()
    assert [entry["seq"] for entry in bench.link.put_] == [1, 2]
    assert bench.last["mono"] > bench.link.put_[0]["mono"]


def test_the_state_is_boot_before_the_first_report() -> None:
    """As the MAVLink heartbeat does."""
    bench = Bench()
    bench.fleet.tick()
    assert bench.last["state"] == "BOOT"
    bench.clock.advance(1)
    bench.fleet.handle(Report(at(), 1, at(), (HEALTHY,)))
    assert bench.last["state"] == "ACTIVE"
    bench.clock.advance(AGAIN_S)
    bench.fleet.tick()
    count = len(bench.link.put_)
    bench.clock.advance(1)
    bench.fleet.handle(Report(at(), 2, at(), (HEALTHY,)))
    bench.fleet.tick()
    assert len(bench.link.put_) == count


def test_a_change_is_published_immediately_and_a_burst_once() -> None:
    """Changes within the next moment wait for the next tick."""
    bench = Bench()
    bench.fleet.tick()
    bench.clock.advance(1)
    bench.states = (HEALTHY, DEAD)
    for _ in range(50):
        bench.fleet.handle(transition(DEAD))
    bench.fleet.handle(opened(DEAD))
    assert len(bench.link.put_) == 2
    assert bench.last["slots"] == {"2": "OK", "6": "ERROR"}
    bench.clock.advance(ALONG_S)
    bench.fleet.tick()
    assert len(bench.link.put_) == 3
    assert (bench.last["open_faults"], bench.last["faults"][0]["brief"]) == (1, "one dead")


def test_a_change_is_published_once_more() -> None:
    """A second later, and then not before the refresh is due."""
    bench = Bench()
    bench.fleet.tick()
    bench.clock.advance(5)
    bench.fleet.handle(transition(DEAD))
    for _ in range(30):
        bench.clock.advance(0.25)
        bench.fleet.tick()
    assert [entry["mono"] - bench.link.put_[0]["mono"] for entry in bench.link.put_] == [0.0, 5.0, 5.0 + AGAIN_S]


def test_a_closed_fault_is_not_listed() -> None:
    """Also one that was open before PHM was restarted."""
    bench = Bench((DEAD,), restored=(fault(DEAD),))
    bench.fleet.tick()
    assert bench.last["open_faults"] == 1
    bench.clock.advance(1)
    bench.fleet.handle(closed(DEAD, Outcome.RESOLVED, "restart", 3.0))
    assert bench.last["open_faults"] == 0


def test_a_stalled_scheduler_withdraws_the_presence() -> None:
    """A dead man's switch: no token, no status, until checks run again."""
    bench = Bench()
    bench.fleet.tick()
    assert bench.link.is_present is True
    bench.alive = False
    bench.clock.advance(100)
    bench.fleet.tick()
    assert (bench.link.is_present, len(bench.link.put_)) == (False, 1)
    bench.alive = True
    bench.fleet.tick()
    assert (bench.link.is_present, len(bench.link.put_)) == (True, 2)


def test_an_intended_shutdown_is_published() -> None:
    """The last status is POWEROFF."""
    bench = Bench()
    bench.fleet.close()
    assert bench.link.last["state"] == "POWEROFF"


def test_a_reload_is_published() -> None:
    """The last status is BOOT: the token is missing until the next reporter is connected, and nothing is wrong."""
    bench = Bench()
    bench.fleet.handle(Report(at(), 1, at(), (HEALTHY,)))
    assert bench.last["state"] == "ACTIVE"
    bench.fleet.hand_over()
    assert bench.link.last["state"] == "BOOT"


def test_only_a_long_disconnection_is_a_problem() -> None:
    """Two deadlines without the fleet, or another PHM of the same name, are reported in slot 1."""
    bench = Bench()
    assert not bench.fleet.problem()
    bench.link.state = replace(CONNECTED, connected=False, since_s=9.0, error="no connection to tcp/r:7447")
    assert not bench.fleet.problem()
    bench.link.state = replace(bench.link.state, since_s=10.0)
    assert bench.fleet.problem() == "Zenoh does not reach the fleet north: no connection to tcp/r:7447"
    bench.link.state = replace(CONNECTED, namesakes=("phm/north/agent_3/alive/x",))
    assert "another PHM is present as phm/north/agent_3/status" in bench.fleet.problem()


def test_phm_status_shows_the_connection(capsys: Any) -> None:
    """Whether it is connected, otherwise the reason."""
    bench = Bench()
    document = {"agent": "agent_3", "checks": [], "health": {"reporters": {"fleet": bench.fleet.report()}}}
    terminal.status(document, "")
    assert "fleet north: connected (3 published, 900 bytes)" in capsys.readouterr().out
    bench.link.state = replace(CONNECTED, connected=False, error="no connection to tcp/r:7447")
    document["health"] = {"reporters": {"fleet": bench.fleet.report()}}
    terminal.status(document, "")
    assert "fleet north: not connected: no connection to tcp/r:7447" in capsys.readouterr().out


def test_the_document_names_every_key() -> None:
    """docs/reference/fleet.md is a contract: each key of the payload is in its table."""
    bench = Bench((HEALTHY, DEAD), restored=(fault(DEAD),))
    bench.fleet.tick()
    text = Path(__file__).parents[2].joinpath("docs", "reference", "fleet.md").read_text()
    missing = [key for key in (*bench.last, *bench.last["faults"][0]) if f"`{key}`" not in text]
    assert not missing
