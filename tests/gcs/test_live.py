"""The live table: keys, the menu of an agent, alarms."""

from __future__ import annotations

import io
from typing import Any

import pytest
from rich.console import Console

from phm.core.model import Level, Slot, Stamp
from phm.gcs.events import GcsEvent
from phm.gcs.live import LiveView
from phm.gcs.operator import OperatorCommand
from phm.gcs.subscriber_queue import QueuedEvent, SubscriberQueue
from phm.testing import FakeClock
from phm.wire import tunnel
from tests.gcs.bench import Ground, phm_heartbeat, text_frame, tunnel_frame


class Station:
    """What the view uses of a station; `sent` has the commands."""

    def __init__(self) -> None:
        self.ground, self.silent, self.sent = Ground(), False, list[tuple[int, str, int]]()
        self._queues: list[SubscriberQueue] = []

    def subscribe(self, queue: SubscriberQueue) -> None:
        self._queues.append(queue)

    def snapshot(self) -> tuple[int, GcsEvent]:
        body = {**self.ground.snapshot(), "system": 254, "component": 190, "problems": [], "frames_refused": 0}
        return 1, GcsEvent(Stamp(0.0, 0.0), "snapshot", body)

    def command(self, system: int, component: int, command: OperatorCommand, confirmation: int, link: str) -> None:
        self.sent.append((system, command.text, confirmation))

    def publish(self, *events: GcsEvent) -> None:
        for queue in self._queues:
            for event in events:
                queue.put(QueuedEvent(1, event, b""))

    def hear(self, *frames: Any) -> None:
        self.publish(*self.ground.hear(*frames))


class Bench:
    """Agents 7, which advises a restart, and 8."""

    def __init__(self) -> None:
        self.station, self.clock = Station(), FakeClock()
        self.view = LiveView(self.station, self.clock, list)  # type: ignore[arg-type]
        advice = text_frame(7, "A07 ADVISE 2 restart ros_app #17 60s", 4)
        self.station.hear(
            phm_heartbeat(7, {Slot.CONTAINER: Level.ERROR}),
            phm_heartbeat(8),
            text_frame(7, "A07 FAIL 2 ros_app exited 1"),
            advice,
        )

    def press(self, *keys: str) -> list[str]:
        """The lines of the screen after these keys."""
        self.view.turn(list(keys))
        self.view.events()
        target = Console(file=io.StringIO(), width=100, height=40)
        target.print(self.view.draw(target, active=True))
        return [line.rstrip() for line in target.file.getvalue().splitlines()]  # type: ignore[attr-defined]

    def answer(self, event: str, **body: Any) -> None:
        self.station.publish(GcsEvent(self.clock.stamp(), event, {"agent": 7, "name": "A07", **body}))


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_an_action_is_approved_with_arrow_keys_and_enter(bench: Bench) -> None:
    """The menu names what is advised, and the answer of the agent follows."""
    lines = bench.press("down", "enter")
    assert "> run all checks" in lines
    assert "  approve restart ros_app (fault #17, an approval is valid for 60 s)" in lines
    bench.press("down", "enter")
    assert bench.station.sent == [(7, "list containers", 0), (7, "approve #17 restart ros_app", 0)]
    assert "A07 approve #17 restart ros_app: sent, no answer yet" in bench.press()
    bench.answer("ack", command=31010, result="DENIED")
    bench.answer("detail", fault="reply", text="'approve' is not in mavlink.commands")
    assert "A07 approve #17 restart ros_app: denied: 'approve' is not in mavlink.commands" in bench.press()


def test_containers_are_offered_once_the_agent_has_named_them(bench: Bench) -> None:
    """Opening the menu asks for them."""
    assert "  restart ros_app" not in bench.press("down", "enter")
    bench.station.hear(tunnel_frame(7, tunnel.details("containers", "1 ros_app, 2 router")[0]))
    lines = bench.press("up")
    assert "> restart router" in lines
    bench.press("enter")
    assert bench.station.sent[-1] == (7, "restart router", 0)


def test_the_selection_goes_round_and_escape_leaves(bench: Bench) -> None:
    """Down from the last agent is the first; Esc closes the menu, then clears the selection."""
    lines = bench.press("down", "down", "enter")
    assert any(line.startswith("A08:") for line in lines)
    lines = bench.press("escape")
    assert any(line.startswith("up/down: choose an agent") for line in lines)
    assert any(line.startswith("A07:") for line in bench.press("down", "enter"))
    bench.press("escape", "escape", "enter")
    assert len(bench.station.sent) == 2


def test_nothing_is_sent_to_an_agent_that_is_not_received(bench: Bench) -> None:
    """Nor by a silent station."""
    bench.press("down", "enter")
    bench.station.sent.clear()
    bench.station.silent = True
    assert "--silent: nothing can be sent" in bench.press("enter")
    bench.station.silent = False
    bench.station.ground.wait(60)
    assert "A07 run all checks: not sent, the agent is lost" in bench.press("enter", "enter")
    assert bench.station.sent == []


def test_a_new_critical_line_rings_and_is_acknowledged(bench: Bench) -> None:
    """Once for each; the agent is marked until `a` is pressed."""
    assert bench.view.events()
    assert not bench.view.events()
    lines = bench.press()
    assert "1 new CRITICAL: A07   a: acknowledge" in lines
    assert any(line.startswith("A07! ") for line in lines)
    assert not any(line.startswith("A07! ") or "new CRITICAL" in line for line in bench.press("a"))
    assert bench.view.turn(["q"])


def test_events_have_ages(bench: Bench) -> None:
    """An operator compares ages, not UTC times."""
    bench.press()
    bench.clock.advance(200)
    assert any(line.lstrip().startswith("3 min ago  CRITICAL A07 FAIL 2") for line in bench.press())
