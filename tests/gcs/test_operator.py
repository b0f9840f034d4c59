"""Requests of the operator: what is offered, how often it is sent, and what the answer says."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from phm.core.model import Level, Slot, Stamp
from phm.gcs import operator
from phm.gcs.alarms import MAX_AGENTS, SHOWN, Alarms
from phm.gcs.events import GcsEvent
from phm.gcs.frames import CommandAck
from phm.gcs.operator import ATTEMPTS, REPLY_S, RESEND_S, Exchange
from phm.gcs.station import GroundStation
from phm.testing import FakeClock, settings
from phm.wire import status_line, tunnel
from phm.wire.command import container_hash
from tests.gcs.bench import Ground, events, phm_heartbeat, text_frame, tunnel_frame

ADVICE = "A07 ADVISE 2 restart ros_app #17 60s"
FAILED = {Slot.CONTAINER: Level.ERROR}


@pytest.fixture
def ground() -> Ground:
    """Agent 7 advises a restart and has named its containers."""
    made = Ground()
    made.receive(phm_heartbeat(7, FAILED), text_frame(7, "A07 FAIL 2 ros_app exited 1"), text_frame(7, ADVICE, 4))
    made.receive(tunnel_frame(7, tunnel.details("containers", "1 ros_app, 2 router")[0]))
    return made


# ---------------------------------------------------------------- what is offered


def test_the_menu_offers_what_is_advised_and_each_container(ground: Ground) -> None:
    """With how long an approval is valid; checks come first, because they harm nothing."""
    choices = operator.menu(ground.agent(7))
    assert [text for text, _ in choices] == [
        "run all checks",
        "approve restart ros_app (fault #17, an approval is valid for 60 s)",
        "restart ros_app",
        "restart router",
    ]
    assert [command.params for _, command in choices] == [(1, 0), (2, 17), (3, 1), (3, 2)]


@pytest.mark.parametrize(
    "over",
    [
        text_frame(7, "A07 APPROVED 2 restart ros_app", 5),
        text_frame(7, "A07 GAVE UP 2 ros_app exited 1 #17"),
        phm_heartbeat(7),
        phm_heartbeat(7, FAILED, state=1),
    ],
    ids=["approved", "given up", "recovered", "restarted"],
)
def test_advice_ends_when_it_can_no_longer_be_approved(ground: Ground, over: Any) -> None:
    """What cannot be approved any more is not offered."""
    assert [one["fault"] for one in ground.agent(7)["advice"]] == [17]
    ground.receive(over)
    assert ground.agent(7)["advice"] == []


@pytest.mark.parametrize("action", ["restart", "join_network"])
def test_advice_about_a_long_name_ends_with_its_approval(ground: Ground, action: str) -> None:
    """The two lines have different room for the name."""
    name = "mavlink-router-container"
    ground.receive(text_frame(7, status_line.advise(7, Slot.CONTAINER, action, name, 18, 60), 4))
    ground.receive(text_frame(7, status_line.approved(7, Slot.CONTAINER, action, name), 5))
    assert [one["fault"] for one in ground.agent(7)["advice"]] == [17]


def test_advice_stays_while_its_slot_is_unknown(ground: Ground) -> None:
    """The fault may still be open, and PHM sends the advice only once. A new fault of the same container replaces it."""

    def offered(*frames: Any) -> list[int]:
        ground.receive(*frames)
        return [one["fault"] for one in ground.agent(7)["advice"]]

    assert offered(phm_heartbeat(7, {Slot.CONTAINER: Level.STALE}), phm_heartbeat(7, FAILED)) == [17]
    assert offered(text_frame(7, "A07 ADVISE 2 restart ros_app #18 60s", 4)) == [18]
    assert offered(text_frame(7, "A07 ADVISE 2 restart ros_app #19 60s", 4)) == [18, 19]


def test_a_restart_names_the_container_by_its_hash(ground: Ground) -> None:
    """Its position may be another container's after a reload. A position that the operator wrote has no name."""
    commands = [command for _, command in operator.menu(ground.agent(7))]
    hashes = [command.name_hash for command in commands]
    assert hashes == [0, 0, container_hash("ros_app"), container_hash("router")]
    assert (operator.restart(3).text, operator.restart(3).name_hash) == ("restart container 3", 0)


def test_a_restarted_phm_must_list_its_containers_again(ground: Ground) -> None:
    """Its configuration may have changed; parts of a list from before the restart are not used either."""
    parts = tunnel.details("containers", ", ".join(f"{n} container_{n}" for n in range(1, 20)))
    ground.receive(tunnel_frame(7, parts[0]), phm_heartbeat(7, FAILED, state=1))
    assert ground.agent(7)["containers"] == []
    ground.receive(*(tunnel_frame(7, part) for part in parts[1:]))
    assert ground.agent(7)["containers"] == []


def test_advice_of_an_older_phm_has_no_time(ground: Ground) -> None:
    """And advice without a number cannot be approved by MAVLink."""
    ground.receive(
        text_frame(7, "A07 ADVISE 6 relaunch node_1 #18", 4), text_frame(7, "A07 ADVISE 6 relaunch node_2", 4)
    )
    advice = ground.agent(7)["advice"]
    assert [(one["fault"], one["target"], one["valid_s"]) for one in advice] == [
        (17, "ros_app", 60.0),
        (18, "node_1", None),
    ]


def test_a_hostile_sender_fills_no_memory(ground: Ground) -> None:
    """Neither advice nor names of containers grow without limit."""
    ground.receive(*(text_frame(7, f"A07 ADVISE 2 start x #{number} 60s", 4) for number in range(100)))
    ground.receive(
        *(tunnel_frame(7, part) for part in tunnel.details("containers", ", ".join(f"{n} c" for n in range(1, 400))))
    )
    assert len(ground.agent(7)["advice"]) == 8
    assert len(ground.agent(7)["containers"]) == 64


# ---------------------------------------------------------------- an exchange


class Bench:
    """An exchange with agent 7; `sent` has the confirmation of each time it was sent."""

    def __init__(self, command: operator.OperatorCommand) -> None:
        self.sent: list[int] = []
        self.exchange = Exchange("A07", command, lambda confirmation, nonce: self.sent.append(confirmation), 0.0)

    def receive(self, event: str, now: float = 0.1, **body: Any) -> None:
        self.exchange.receive(GcsEvent(Stamp(0.0, now), event, {"agent": 7, "name": "A07", **body}), now)


def test_the_answer_is_the_result_and_its_text() -> None:
    """Answers to other commands, and of other agents, are not taken for it."""
    bench = Bench(operator.approve(17, "restart ros_app"))
    bench.receive("ack", command=512, result="ACCEPTED")
    bench.receive("ack", name="A08", command=31010, result="ACCEPTED")
    assert not bench.exchange.done(0.2)
    bench.receive("ack", command=31010, result="DENIED")
    assert not bench.exchange.done(0.3)
    bench.receive("detail", fault="reply", text="'approve' is not in mavlink.commands")
    assert bench.exchange.done(0.4)
    assert not bench.exchange.accepted
    expected = "A07 approve #17 restart ros_app: denied: 'approve' is not in mavlink.commands"
    assert bench.exchange.answer() == expected


@pytest.mark.parametrize("result", ["DENIED", "TEMPORARILY_REJECTED", "UNSUPPORTED", "FAILED"])
def test_a_refusal_without_a_text_still_says_why(result: str) -> None:
    """An older PHM sends none, and a radio may lose it."""
    bench = Bench(operator.run_checks())
    bench.receive("ack", command=31010, result=result)
    assert not bench.exchange.done(REPLY_S - 0.1)
    assert bench.exchange.done(REPLY_S + 0.2)
    assert bench.exchange.answer().startswith(f"A07 run all checks: {result.lower().replace('_', ' ')}: ")


def test_an_unanswered_command_is_sent_again_as_a_repetition() -> None:
    """The agent executes it once, by its `confirmation`; in the end there is no answer."""
    bench = Bench(operator.restart(1, "ros_app"))
    times = [step * RESEND_S / 2 for step in range(1, 2 * ATTEMPTS + 2)]
    done = [bench.exchange.done(now) for now in times]
    assert bench.sent == list(range(ATTEMPTS))
    assert done.index(True) == 2 * ATTEMPTS - 1
    assert bench.exchange.answer() == "A07 restart ros_app: no answer within 6 s"


def test_the_hash_of_the_name_is_sent_in_param3(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which only a restart has."""
    station, sent = GroundStation(settings().mavlink, 254, FakeClock()), list[Any]()
    monkeypatch.setattr(station, "_hub", SimpleNamespace(send=lambda message, *, link: sent.append(message)))
    for command in (operator.restart(2, "router"), operator.restart(2), operator.approve(17)):
        station.command(7, 193, command, 0, 1.0)
    params = [(one.param1, one.param2, one.param3) for one in sent]
    assert params == [(3, 2, container_hash("router")), (3, 2, 0), (2, 17, 0)]


def test_only_answers_to_this_ground_station_are_events(ground: Ground) -> None:
    """Of agents that are known; the autopilot's own are not."""
    assert ground.receive(CommandAck(7, 193, 31010, 0, (255, 190)), CommandAck(7, 1, 31010, 0, (254, 190))) == []
    found = ground.receive(CommandAck(7, 193, 31010, 2, (254, 190)))
    assert events(found, "ack") == [{"agent": 7, "name": "A07", "command": 31010, "result": "DENIED"}]


# ---------------------------------------------------------------- alarms


def test_a_critical_line_is_an_alarm_until_it_is_acknowledged(ground: Ground) -> None:
    """Once for each line; repetitions, warnings and text of other programs are none."""
    alarms = Alarms()
    lines = [
        text_frame(7, "A07 FAIL 6 node_1 dead"),
        text_frame(7, "A07 FAIL 6 node_1 dead"),
        text_frame(7, "A07 WARN 9 disk / 88%", 4),
        text_frame(7, "hello", component=1),
    ]
    news = ground.receive(*lines)
    assert [alarms.take(event, "A07") for event in news] == [True, False, False, False]
    assert alarms.text() == "1 new CRITICAL: A07   a: acknowledge"
    alarms.acknowledge()
    assert alarms.text() == ""


def test_the_alarms_of_a_flood_are_limited_and_those_of_expected_agents_stay(ground: Ground) -> None:
    """The line names them first, and counts the others."""
    alarms = Alarms(["A07", "A08"])
    (event,) = (one for one in ground.receive(text_frame(7, "A07 FAIL 6 node_1 dead")) if one.event == "text")
    names = ["A07", *(f"A250/{number}" for number in range(MAX_AGENTS)), "A08"]
    assert all(alarms.take(event, name) for name in names)
    assert len(alarms.names) == MAX_AGENTS and {"A07", "A08"} <= alarms.names.keys()
    head, _, rest = alarms.text().partition(": ")
    assert head == f"{len(names)} new CRITICAL"
    assert rest.startswith("A07 A08 A250/2 ")
    assert rest.endswith(f" and {len(names) - SHOWN} more   a: acknowledge")
    alarms.acknowledge()
    assert alarms.text() == ""
