"""The live table: keys, the menu of an agent, alarms."""

from __future__ import annotations

import io
from typing import Any

import pytest
from rich.console import Console

from phm.core.model import Level, Slot, Stamp
from phm.gcs.events import GcsEvent
from phm.gcs.live import MAX_CHOICES, LiveView
from phm.gcs.operator import ATTEMPTS, RESEND_S, OperatorCommand
from phm.gcs.subscriber_queue import QueuedEvent, SubscriberQueue
from phm.testing import FakeClock
from phm.wire import tunnel
from tests.gcs.bench import Ground, phm_heartbeat, text_frame, tunnel_frame


class Station:
    """What the view uses of a station; `sent` has the commands."""

    def __init__(self) -> None:
        self.ground, self.silent, self.sent = Ground(), False, list[tuple[int, str, int]]()
        self.expected = frozenset[str]()
        self._queues: list[SubscriberQueue] = []

    def subscribe(self, queue: SubscriberQueue) -> None:
        self._queues.append(queue)

    def snapshot(self) -> tuple[int, GcsEvent]:
        body = {**self.ground.snapshot(), "system": 254, "component": 190, "problems": [], "frames_refused": 0}
        return 1, GcsEvent(Stamp(0.0, 0.0), "snapshot", body)

    def command(
        self, system: int, component: int, command: OperatorCommand, confirmation: int, nonce: float, link: str
    ) -> None:
        self.sent.append((system, command.text, confirmation))

    def forget_containers(self, system: int, component: int) -> None:
        self.ground.store.fleet.agents[system, component].forget_containers()

    def publish(self, *events: GcsEvent) -> None:
        for queue in self._queues:
            for event in events:
                queue.put(QueuedEvent(1, event, b""))

    def receive(self, *frames: Any) -> None:
        self.publish(*self.ground.receive(*frames))


class Bench:
    """Agents 7, which advises a restart, and 8."""

    def __init__(self) -> None:
        self.station, self.clock = Station(), FakeClock()
        self.view = LiveView(self.station, self.clock, list)  # type: ignore[arg-type]
        advice = text_frame(7, "A07 ADVISE 2 restart ros_app #17 60s", 4)
        self.station.receive(
            phm_heartbeat(7, {Slot.CONTAINER: Level.ERROR}),
            phm_heartbeat(8),
            text_frame(7, "A07 FAIL 2 ros_app exited 1"),
            advice,
        )

    def press(self, *keys: str) -> list[str]:
        """The lines of the screen after these keys."""
        self.view.handle_keys(list(keys))
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
    bench.station.receive(tunnel_frame(7, tunnel.details("containers", "1 ros_app, 2 router")[0]))
    assert "  restart router" in bench.press()
    lines = bench.press("up")
    assert "> restart router" in lines
    bench.press("enter")
    assert bench.station.sent[-1] == (7, "restart router", 0)


def receive_containers(bench: Bench, listed: str) -> None:
    """The agent answers the request for its containers."""
    bench.station.receive(tunnel_frame(7, tunnel.details("containers", listed)[0]))
    bench.answer("ack", command=512, result="ACCEPTED")


APPROVED = text_frame(7, "A07 APPROVED 2 restart ros_app", 5)
OTHER_ADVICE = text_frame(7, "A07 ADVISE 6 relaunch node_1 #18 60s", 4)


def test_enter_sends_only_what_the_screen_shows(bench: Bench) -> None:
    """Advice that came and went since the last draw must not put another action under the selection."""
    lines = bench.press("down", "enter", "down")
    assert "> approve restart ros_app (fault #17, an approval is valid for 60 s)" in lines
    bench.station.receive(APPROVED, OTHER_ADVICE)
    lines = bench.press("enter")
    assert "A07 approve #17 restart ros_app: not sent, it is no longer available" in lines
    assert [text for _, text, _ in bench.station.sent] == ["list containers"]


def test_arrow_keys_move_on_the_lines_that_the_screen_shows(bench: Bench) -> None:
    """Keys that are pressed before the next draw mean the lines of the last one."""
    bench.press("down", "enter")
    bench.station.receive(APPROVED, OTHER_ADVICE)
    lines = bench.press("down", "enter")
    assert "A07 approve #17 restart ros_app: not sent, it is no longer available" in lines
    assert [text for _, text, _ in bench.station.sent] == ["list containers"]


def test_the_lines_of_an_open_menu_do_not_move(bench: Bench) -> None:
    """What is over stays selected and says so; what is new comes last."""
    bench.press("down", "enter", "down")
    bench.station.receive(APPROVED, OTHER_ADVICE)
    lines = bench.press()
    first = lines.index("  run all checks")
    assert lines[first + 1 : first + 3] == [
        "> approve restart ros_app (fault #17, an approval is valid for 60 s) (no longer available)",
        "  approve relaunch node_1 (fault #18, an approval is valid for 60 s)",
    ]


def test_an_open_menu_has_a_limit(bench: Bench) -> None:
    """Advice that comes and goes adds no lines without end."""
    bench.press("down", "enter")
    for fault in range(100, 100 + 2 * MAX_CHOICES):
        bench.station.receive(text_frame(7, f"A07 ADVISE 2 start x #{fault} 60s", 4))
        bench.press()
    assert len(bench.view._choices) == MAX_CHOICES


def test_opening_the_menu_forgets_the_containers(bench: Bench) -> None:
    """The configuration may have changed since: restarts are offered once the agent has listed them again."""
    bench.press("down", "enter")
    receive_containers(bench, "1 ros_app, 2 router")
    assert "  restart router" in bench.press()
    lines = bench.press("escape", "enter")
    assert not any("restart router" in line for line in lines)
    receive_containers(bench, "1 router")
    assert "  restart router" in bench.press()
    bench.press("escape")
    assert [text for _, text, _ in bench.station.sent] == ["list containers", "list containers"]


def test_a_list_that_is_on_its_way_is_not_requested_again(bench: Bench) -> None:
    """And what of it has arrived is kept."""
    bench.press("down", "enter")
    bench.station.receive(tunnel_frame(7, tunnel.details("containers", "1 ros_app")[0]))
    assert "  restart ros_app" in bench.press("escape", "enter")
    assert [text for _, text, _ in bench.station.sent] == ["list containers"]


def test_a_request_waits_for_the_answer_to_the_one_before(bench: Bench) -> None:
    """An acknowledgement names no more than the command, and approve, restart and check are one command."""
    bench.press("down", "enter", "enter")
    lines = bench.press("enter", "down", "enter")
    refused = "A07 approve #17 restart ros_app: not sent, still waiting for the answer to run all checks"
    assert refused in lines
    bench.press("down", "enter", "enter")  # another agent need not wait
    bench.answer("ack", command=31010, result="ACCEPTED")
    bench.answer("detail", fault="reply", text="running all checks")
    bench.press()
    lines = bench.press("up", "enter", "down", "enter")
    assert "A07 run all checks: accepted: running all checks" in lines
    assert "A07 approve #17 restart ros_app: sent, no answer yet" in lines
    assert [(agent, text) for agent, text, _ in bench.station.sent if text != "list containers"] == [
        (7, "run all checks"),
        (8, "run all checks"),
        (7, "approve #17 restart ros_app"),
    ]


def test_a_request_may_follow_one_that_was_never_answered(bench: Bench) -> None:
    """After its last repetition."""
    bench.press("down", "enter", "enter")
    for _ in range(ATTEMPTS + 1):
        bench.clock.advance(RESEND_S)
        bench.press()
    lines = bench.press("enter", "down", "enter")
    assert "A07 run all checks: no answer within 6 s" in lines
    assert "A07 approve #17 restart ros_app: sent, no answer yet" in lines


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
    assert bench.view.handle_keys(["q"])


def test_events_have_ages(bench: Bench) -> None:
    """An operator compares ages, not UTC times."""
    bench.press()
    bench.clock.advance(200)
    assert any(line.lstrip().startswith("3 min ago  CRITICAL A07 FAIL 2") for line in bench.press())
