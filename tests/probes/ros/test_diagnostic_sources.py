"""Statuses of one name from several publishers: which of them count."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import pytest

from phm import api, testing
from phm.api import Layer, Slot
from phm.core.model import FaultOpened, Stamp
from phm.facts.ros import DiagnosticFact
from phm.probes.ros.diagnostic_sources import MAX_SOURCES, key_of, name_of
from phm.probes.ros.protocol import SelfReportUpdate
from phm.probes.ros.self_reports import MAX_NAMES, ConfiguredNames, SelfReports
from phm.tracker import TrackedUnit, Tracker, graph_of
from phm_checks.diagnostics import Diagnostics

NAME = "camera: Frequency"
LEFT, RIGHT, NEW = b"left", b"right", b"new"


@dataclass
class Domain:
    """The statuses that the daemon has received, each second."""

    now_s: float = 100.0
    reports: SelfReports = field(
        default_factory=lambda: SelfReports(configured=ConfiguredNames(statuses=("camera: *",)))
    )

    def receive_together(self, *sources: tuple[bytes, str]) -> None:
        """In one update: (publisher, hardware id) of each."""
        self.now_s += 1.0
        facts = {
            key_of(NAME, ident, writer): DiagnosticFact(0.0, 0, writer.decode(), ident) for writer, ident in sources
        }
        self.reports = self.reports.with_update(SelfReportUpdate(diagnostics=facts), self.now_s)

    def receive(self, writer: bytes, level: int = 0, hardware_id: str = "none", name: str = NAME) -> None:
        fact = DiagnosticFact(0.0, level, writer.decode(), hardware_id)
        update = SelfReportUpdate(diagnostics={key_of(name, hardware_id, writer): fact})
        self.reports = self.reports.with_update(update, self.now_s)

    def run(self, seconds: int, **levels: int) -> None:
        """Both publish once a second, half a second apart. levels: of the publishers by name."""
        for number in range(2 * seconds):
            self.now_s += 0.5
            writers = list(levels)
            if writer := writers[number % 2 :][:1]:
                self.receive(writer[0].encode(), levels[writer[0]])

    def found(self) -> dict[str, int]:
        """The level of each publisher whose status counts, 3 if it is silent for more than 5 s."""
        several = self.reports.same_named(self.now_s)
        facts = several.get(NAME) or (self.reports.since(self.now_s)[1][NAME],)
        return {fact.message: 3 if fact.age_s > 5.0 else fact.level for fact in facts}


def test_the_status_of_each_publisher_is_kept() -> None:
    """Neither hides that of the other, and none wakes the checks as long as its level stays the same."""
    domain = Domain()
    domain.run(10, left=2, right=0)
    assert domain.found() == {"left": 2, "right": 0}
    again = SelfReportUpdate(diagnostics={key_of(NAME, "none", RIGHT): DiagnosticFact(0.0, 0, "right", "none")})
    assert not domain.reports.differs(again)
    assert set(domain.reports.since(domain.now_s)[1]) == {NAME}


def test_the_silence_of_one_publisher_remains_when_the_other_is_restarted() -> None:
    """The new process replaces only one of them."""
    domain = Domain()
    domain.run(10, left=0, right=0)
    domain.run(10, right=0)
    assert domain.found() == {"left": 3, "right": 0}
    domain.run(10, new=0)
    assert domain.found() == {"left": 3, "new": 0}


def test_a_restarted_publisher_leaves_nothing() -> None:
    """A new process has another identity."""
    domain = Domain()
    domain.run(10, left=2)
    domain.run(3)
    domain.run(10, new=0)
    assert domain.found() == {"new": 0}


def test_a_publisher_that_sets_its_hardware_id_later_leaves_nothing() -> None:
    """diagnostic_updater begins with `none`."""
    domain = Domain()
    domain.run(10, left=0)
    for _ in range(10):
        domain.now_s += 1.0
        domain.receive(LEFT, hardware_id="cam-07")
    assert domain.found() == {"left": 0} and NAME not in domain.reports.same_named(domain.now_s)


@pytest.mark.parametrize(("writer", "hardware_id"), [(NEW, "none"), (LEFT, "cam-07")])
def test_a_publisher_that_is_replaced_within_one_update_leaves_nothing(writer: bytes, hardware_id: str) -> None:
    """Its last status and the first one of the new source are received together."""
    domain = Domain()
    domain.run(10, left=0)
    domain.receive_together((LEFT, "none"), (writer, hardware_id))
    assert len(domain.reports.same_named(domain.now_s)[NAME]) == 2
    for _ in range(10):
        domain.now_s += 1.0
        domain.receive(writer, hardware_id=hardware_id)
    assert domain.found() == {writer.decode(): 0} and NAME not in domain.reports.same_named(domain.now_s)


def test_publishers_that_are_first_received_together_all_count() -> None:
    """A new one that begins in the same update as a message of a living one replaces only the one that was silent."""
    domain = Domain()
    domain.receive_together((LEFT, "none"), (RIGHT, "none"))
    assert domain.found() == {"left": 0, "right": 0}
    domain.run(10, left=0, right=0)
    assert domain.found() == {"left": 0, "right": 0}
    domain.run(10, right=0)
    assert domain.found() == {"left": 3, "right": 0}
    domain.receive_together((RIGHT, "none"), (NEW, "none"))
    domain.run(10, right=0, new=0)
    assert domain.found() == {"right": 0, "new": 0}
    domain.run(10, new=0)
    assert domain.found() == {"right": 3, "new": 0}


def test_a_single_message_of_another_publisher_leaves_nothing() -> None:
    """E.g. of `ros2 topic pub --once`; while it is new, it counts."""
    domain = Domain()
    domain.run(10, right=0)
    domain.receive(NEW, 2)
    domain.run(1, right=0)
    assert domain.found() == {"right": 0, "new": 2}
    domain.run(10, right=0)
    assert domain.found() == {"right": 0}


def test_the_sources_of_one_name_are_limited() -> None:
    """Identities can be invented. Names remain limited as before."""
    domain = Domain()
    for number in range(4 * MAX_SOURCES):
        domain.now_s += 0.1
        domain.receive(str(number).encode(), hardware_id=str(number))
    assert len(domain.reports.diagnostics) == MAX_SOURCES
    for number in range(2 * MAX_NAMES):
        domain.receive(LEFT, name=f"camera: {number}")
    assert len(domain.reports.diagnostics) == MAX_NAMES and domain.reports.unkept_at is not None
    assert {name_of(key) for key in domain.reports.diagnostics} == set(domain.reports.since(domain.now_s)[1])


def test_an_error_of_one_of_two_publishers_opens_a_fault() -> None:
    """And so does its silence, instead."""
    for level, condition in ((2, "diagnostic_error"), (None, "diagnostic_stale")):
        domain, ros = Domain(), testing.FakeRos(age_s=0.0)
        (check,) = Diagnostics.build(testing.settings(ros={"diagnostics": {"watch": [{"name": "camera: *"}]}}))
        (unit,) = check.units
        tracked = [TrackedUnit(replace(unit, needs=()), "diagnostics", Slot.NODES, Layer.ROS, 1, (), ())]
        tracker = Tracker(tracked, graph_of(tracked), Stamp(0.0, domain.now_s))
        domain.run(5, left=0, right=0)
        opened = []
        for _ in range(30):
            domain.run(1, **{"right": 0, "left": 0 if level is None else level} if level is not None else {"right": 0})
            ros.change(
                diagnostics=domain.reports.since(domain.now_s)[1],
                diagnostic_sources=domain.reports.same_named(domain.now_s),
            )
            results = check.run(testing.world(ros=ros))
            assert not isinstance(results, api.Result)
            stamp = Stamp(domain.now_s, domain.now_s)
            events = [
                *tracker.observe(unit.id, results[unit.id], domain.now_s, stamp).events,
                *tracker.tick(stamp).events,
            ]
            opened += [event.fault.result.condition for event in events if isinstance(event, FaultOpened)]
        assert opened == [condition]
