"""Lines that wait for a link's budget are sent only while they are true."""

from __future__ import annotations

from collections.abc import Set
from dataclasses import replace
from typing import Any

import pytest

from phm.commands import responses
from phm.core.model import ON_HOLD, ActionEvent, Level, Phase, Result, Transition
from phm.testing import FakeClock
from phm.transport.mavlink_codec import Codec
from phm.transport.priority import MessagePriority
from phm.transport.send_queue import SendQueue
from phm.wire.command import STATUSTEXT, requested_key
from tests.fakes.mavlink import FakePort
from tests.reporters.test_mavlink import Scene

FAIL = "A01 FAIL 6 a dead"


class Link:
    """One link with a real send queue. It carries nothing while it is full."""

    def __init__(self, clock: FakeClock) -> None:
        self.queue, self._codec = SendQueue(clock, None), Codec(1, 193, lambda _: False)

    def put(self, message: Any, *words: Any, **how: Any) -> None:
        self.queue.put(message, self._codec.size(message), *words, **how)

    def left(self, least: int) -> list[str]:
        """The lines of at most this severity number that leave now."""
        messages = [item.message for item in iter(self.queue.take, None)]
        return [each.text for each in messages if each.get_type() == "STATUSTEXT" and each.severity <= least]


class Links(FakePort):
    """Two links: one may be full while the other carries."""

    def __init__(self, clock: FakeClock) -> None:
        super().__init__()
        self.links_ = (Link(clock), Link(clock))

    def send(self, message: Any, *words: Any, **how: Any) -> None:
        for each in self.links_:
            each.put(message, *words, **how)

    def set_true(self, names: Set[str]) -> None:
        for each in self.links_:
            each.queue.set_true(names)


@pytest.fixture
def scene() -> Scene:
    scene = Scene(refresh=600)
    scene.port = Links(scene.clock)
    scene.restart()
    scene.running()
    left(scene, 0)
    left(scene, 1)
    return scene


def left(scene: Scene, link: int = 0, least: int = 5) -> list[str]:
    """The lines that leave on this link once it has room, without those of severity INFO."""
    assert isinstance(scene.port, Links)
    return scene.port.links_[link].left(least)


def hold(scene: Scene) -> None:
    """The failing unit is put on hold."""
    failed = scene.units["nodes/a"]
    held = replace(failed, level=Level.STALE, result=Result(Level.STALE, "", "on hold", ON_HOLD), fault="")
    scene.units["nodes/a"] = held
    scene.reporter.handle(Transition(scene.clock.stamp(), failed.level, held))


def test_a_failure_that_has_become_a_consequence_is_not_sent(scene: Scene) -> None:
    """Its cause was reported, and an alarm for each consequence would follow minutes later."""
    scene.become("nodes/a", Level.ERROR, "a dead")
    scene.become("container/app", Level.ERROR, "app exited")
    scene.become("nodes/a", Level.STALE, blocked_by="container/app")
    assert left(scene) == ["A01 FAIL 2 app exited"]


def test_it_is_sent_when_its_unit_fails_again_with_the_same_text(scene: Scene) -> None:
    """What was counted as sent must not be lost."""
    scene.become("nodes/a", Level.ERROR, "a dead")
    scene.become("nodes/a", Level.STALE)
    assert left(scene) == []
    scene.become("nodes/a", Level.ERROR, "a dead")
    assert left(scene) == [FAIL]


def test_each_link_sends_what_it_has_not_sent(scene: Scene) -> None:
    """The failure has left on the first one."""
    scene.become("nodes/a", Level.ERROR, "a dead")
    assert left(scene, 0) == [FAIL]
    scene.become("nodes/a", Level.STALE)
    scene.become("nodes/a", Level.ERROR, "a dead")
    assert (left(scene, 0), left(scene, 1)) == ([], [FAIL])


def test_a_failure_that_ended_in_a_hold_is_not_sent(scene: Scene) -> None:
    """Its end has no line, so it would remain at the ground."""
    scene.become("nodes/a", Level.ERROR, "a dead")
    hold(scene)
    assert left(scene) == []
    scene.become("nodes/a", Level.OK)
    assert left(scene) == []
    scene.become("nodes/a", Level.ERROR, "a dead")
    assert left(scene) == [FAIL]


def test_only_the_end_of_a_failure_is_sent_when_it_is_over(scene: Scene) -> None:
    """The end replaces the failure."""
    scene.become("nodes/a", Level.ERROR, "a dead")
    scene.become("nodes/a", Level.OK)
    (line,) = left(scene)
    assert line.startswith("A01 OK 6")


def test_a_request_whose_fault_is_over_is_not_sent(scene: Scene) -> None:
    """The operator would approve it in vain."""
    scene.become("nodes/a", Level.ERROR, "a dead")
    left(scene)
    asked = ActionEvent(scene.clock.stamp(), "ab12-17", "nodes/a", "restart", "app", Phase.ADVISED)
    scene.reporter.handle(asked)
    scene.become("nodes/a", Level.OK)
    assert [line for line in left(scene) if "ADVISE" in line] == []
    scene.become("nodes/a", Level.ERROR, "a dead")
    scene.reporter.handle(asked)
    assert "A01 ADVISE 6 restart app #17 60s" in left(scene)


def test_a_reload_keeps_what_waits(scene: Scene) -> None:
    """The queue outlives the reporter: the next one says what is true."""
    scene.become("nodes/a", Level.ERROR, "a dead")
    scene.become("nodes/a", Level.STALE)
    scene.reporter.hand_over()
    scene.restart()
    scene.running()
    assert left(scene) == []
    scene.become("nodes/a", Level.ERROR, "a dead")
    assert left(scene) == [FAIL]


def test_a_refresh_that_waits_says_what_is_true_when_it_leaves(scene: Scene) -> None:
    """The failure leaves before it, and a refresh from before would say that all is OK. None is sent where none waits."""
    scene.pass_time(600.5)
    assert left(scene, 1, least=6) == ["A01 OK -1---1--"]
    scene.become("nodes/a", Level.ERROR, "a dead")
    assert left(scene, 0, least=6) == [FAIL, "A01 FAIL -1---0-- 6 a dead"]
    assert left(scene, 1, least=6) == [FAIL]


def test_a_requested_line_that_waits_says_what_is_true_when_it_leaves(scene: Scene) -> None:
    """It leaves after the failure, too."""
    assert isinstance(scene.port, Links)
    healthy = responses.status(STATUSTEXT, 1, tuple(scene.units.values()), complete=True, mono=0.0, utc=0.0)
    assert healthy.text == "A01 OK -1---1--"
    scene.port.links_[0].put(healthy, MessagePriority.REQUEST, requested_key(STATUSTEXT), 1)
    scene.become("nodes/a", Level.ERROR, "a dead")
    assert left(scene, 0, least=6) == [FAIL, "A01 FAIL -1---0-- 6 a dead"]
    assert left(scene, 1, least=6) == [FAIL]
