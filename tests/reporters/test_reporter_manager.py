"""The reporters of one PHM: a failure of one does not affect the others."""

from __future__ import annotations

from typing import Any, ClassVar

import pytest

from phm.checking import registry
from phm.checking.registry import Plugin
from phm.core.bus import Bus
from phm.core.clock import SystemClock
from phm.core.closing import ShutdownSequence
from phm.core.model import Event, Note
from phm.core.settings import Settings
from phm.reporters.base import Reporter, ReporterContext
from phm.reporters.reporter_manager import ReporterManager
from tests.fakes.records import at, context


class Plain(Reporter):
    """Records the events that it received."""

    name = "plain"
    received: ClassVar[list[Event]] = []
    closed = 0

    @classmethod
    def build(cls, context: ReporterContext) -> Reporter | None:
        return cls()

    def handle(self, event: Event) -> None:
        self.received.append(event)

    def problem(self) -> str:
        return f"{self.name} has a problem"

    def close(self) -> None:
        type(self).closed += 1


class Unbuildable(Plain):
    @classmethod
    def build(cls, context: ReporterContext) -> Reporter | None:
        raise RuntimeError("no such display")


class Unwanted(Plain):
    @classmethod
    def build(cls, context: ReporterContext) -> Reporter | None:
        return None


class Leaving(Plain):
    @classmethod
    def build(cls, context: ReporterContext) -> Reporter | None:
        raise SystemExit("no such display")


class Unclosable(Plain):
    def close(self) -> None:
        raise OSError("gone")


def test_a_failing_reporter_does_not_affect_the_others(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Not loaded, not built, not enabled, not closed: the others are built, get events, are queried and closed."""
    kinds = {
        "a_broken": Unbuildable,
        "a_leaving": Leaving,
        "b_unwanted": Unwanted,
        "c_stuck": Unclosable,
        "plain": Plain,
    }
    found = [Plugin(name, "test 1.0", kind) for name, kind in kinds.items()]
    monkeypatch.setattr(registry, "find", lambda group, base: [Plugin("x", "test 1.0", None, "no module"), *found])
    bus = Bus(SystemClock())
    reporters = ReporterManager(bus)
    reporters.start(context(Settings()))
    bus.publish(Note(at(), "PHM", "hello"))
    bus.close()
    assert len(Plain.received) == 2
    assert reporters.problems() == ["plain has a problem"] * 2
    closing = ShutdownSequence(SystemClock(), 60.0)
    for name, close in reporters.closers():
        closing.step(name, close, 60.0)
    assert Plain.closed == 1
    assert [record.message for record in caplog.records] == [
        "reporter a_broken cannot be started",
        "reporter a_leaving cannot be started",
        "closing plain failed",
    ]


class Unanswering(Plain):
    name = "unanswering"

    def problem(self) -> str:
        raise KeyError("destination")

    def report(self) -> dict[str, Any]:
        return {("no", "key", "of JSON"): 1}  # type: ignore[dict-item]


class Silent(Plain):
    name = "silent"

    def problem(self) -> str:
        return None  # type: ignore[return-value]


class Odd(Plain):
    name = "odd"

    def problem(self) -> str:
        return 7  # type: ignore[return-value]

    def report(self) -> dict[str, Any]:
        raise SystemExit(3)


def test_a_reporter_that_cannot_be_asked_is_a_problem_and_hides_no_other(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Its state is asked for where a missing autopilot is reported, and for the status file."""
    found = [Plugin(kind.name, "test 1.0", kind) for kind in (Unanswering, Odd, Silent, Plain)]
    monkeypatch.setattr(registry, "find", lambda group, base: found)
    bus = Bus(SystemClock())
    reporters = ReporterManager(bus)
    reporters.start(context(Settings()))
    monkeypatch.setattr(Plain, "report", lambda self: {"sent": 3})
    for _ in range(2):
        first, second, third = reporters.problems()
        assert "unanswering" in first and "destination" in first
        assert "odd" in second and third == "plain has a problem"
        assert reporters.reports() == {"silent": {"sent": 3}, "plain": {"sent": 3}}
    assert len(caplog.records) == 2, "each is logged once"
    bus.close()
