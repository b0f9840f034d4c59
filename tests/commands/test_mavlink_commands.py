"""The complete handler without sockets: a command in, an acknowledgement to its sender out, and the action taken."""

from __future__ import annotations

import math
from typing import Any

import pytest

from phm.commands import responses
from phm.commands.command_log import LOGGED_PER_PERIOD, PERIOD_S
from phm.commands.handler import CHECK_EVERY_S, CommandHandler
from phm.commands.mavlink_commands import MAX_WAITING, MavlinkCommands
from phm.commands.rate_limit import SENDER_BURST
from phm.commands.services import CommandServices
from phm.core.model import Fault, HostReadings, Layer, Level, Result as Found, Slot, Stamp, UnitState
from phm.facts import DiskFact
from phm.testing import FakeClock, FakeHost, settings, world
from phm.transport.dialect import mavlink
from phm.transport.priority import MessagePriority
from phm.wire import status_word, tunnel
from phm.wire.command import CommandResult, container_hash
from phm_checks.host import Host
from tests.fakes.mavlink import Sender
from tests.fakes.until import until

ALL = ["status", "details", "check", "approve", "restart"]


class Later(Exception):
    pass


def fault(number: int, opened: float, words: str = "node_1 is dead") -> Fault:
    found = Found(Level.ERROR, words, "node_1 dead", "node_missing", "app")
    return Fault(
        f"ab12-{number}", "nodes/node_1", Slot.NODES, Layer.ROS, found, Stamp(1e9, opened), consequences=("topics",)
    )


class Scene:
    """Agent 7 with the services of its handler; `did` has the actions, `notes` the logged texts."""

    def __init__(self, *allowed: str, signs: bool = False) -> None:
        self.clock, self.sent, self.did, self.notes = FakeClock(), [], [], []  # type: ignore[var-annotated]
        self.system_id, self.component_id, self.agents, self.signs = 7, 193, 1, signs
        self.urgencies: list[int] = []
        self.faults: tuple[Fault, ...] = ()
        self.raises: BaseException | None = None
        self.checks_alive = True
        readings = HostReadings(cpu_percent=41.6, memory_percent=50.0)
        host = UnitState(
            "host/cpu",
            "host",
            Slot.HOST,
            Layer.COMPANION,
            Level.OK,
            Found(Level.OK, "healthy", readings=readings),
            Stamp(0, 0),
        )
        self.states = [host]
        services = CommandServices(
            lambda: tuple(self.states),
            lambda: self.faults,
            lambda: (),
            lambda: True,
            lambda: self.checks_alive,
            run_checks=lambda: self.did.append("look"),
            approve=lambda name: self._do(f"approve {name}"),
            restart=lambda key, by: self._do(f"restart {key} for {by}"),
            note=lambda kind, text: self.notes.append(f"{kind}: {text}"),
            later=Later,
            remember=lambda: self._do("remember"),
        )
        chosen = settings(
            agent={"id": 7}, containers=[{"name": "app"}, {"name": "db"}], mavlink={"commands": list(allowed)}
        )
        self.handler = MavlinkCommands(
            self, CommandHandler(services, ["app", "db"], self.clock), services, chosen.mavlink, 7, self.clock
        )
        self.handler.listen()
        self.ground = Sender(255, 190)

    def _do(self, what: str) -> str:
        if self.raises is not None:
            raise self.raises
        self.did.append(what)
        return what

    def send(
        self,
        message: Any,
        kind: MessagePriority = MessagePriority.TRANSITION,
        *,
        key: str = "",
        urgency: int = 0,
        link: str = "",
    ) -> None:
        assert kind is MessagePriority.REQUEST
        self.sent.append((message, link))
        self.urgencies.append(urgency)

    def listen(self, callback: Any, ids: Any) -> None:
        assert set(ids) == {75, 76}

    def ask(self, message: Any, *, link: str = "radio", signed: bool = False, by: Sender | None = None) -> list[Any]:
        """The messages sent in response."""
        received = (by or self.ground).received(message)
        received._signed = signed
        self.sent.clear()
        self.handler.receive(received, link)
        self.handler.tick()
        assert {on for _message, on in self.sent} <= {link}
        return [message for message, _link in self.sent]

    def result(self, message: Any, **how: Any) -> CommandResult:
        acks = [sent for sent in self.ask(message, **how) if sent.get_type() == "COMMAND_ACK"]
        assert len(acks) == 1
        assert (acks[0].command, acks[0].target_system, acks[0].target_component) == (message.command, 255, 190)
        return CommandResult(acks[0].result)


def long(
    command: int,
    first: float = 0,
    second: float = 0,
    third: float = 0,
    *,
    to: tuple[int, int] = (7, 193),
    again: int = 0,
) -> Any:
    return mavlink.MAVLink_command_long_message(*to, command, again, first, second, third, 0, 0, 0, 0)


def test_a_command_int_is_a_command_too() -> None:
    """Both forms, the same answer."""
    scene = Scene(*ALL)
    assert (
        scene.result(mavlink.MAVLink_command_int_message(7, 193, 0, 31010, 0, 0, 1, 0, 0, 0, 0, 0, 0))
        is CommandResult.ACCEPTED
    )
    assert scene.did == ["look"]


@pytest.mark.parametrize("to", [(8, 193), (7, 1), (0, 0), (0, 193), (7, 194)])
def test_commands_for_others_are_not_answered(to: tuple[int, int]) -> None:
    """For another system, another component, or all systems."""
    scene = Scene(*ALL)
    assert scene.ask(long(31010, 3, 1, to=to)) == []
    assert (scene.did, scene.notes) == ([], [])


def test_a_command_from_our_own_identity_is_ignored() -> None:
    """From any sender, especially an echo of a router."""
    scene = Scene(*ALL)
    assert scene.ask(long(31010, 1), by=Sender(7, 193)) == []
    assert scene.did == []


def test_the_default_only_reads() -> None:
    """The shipped setting denies every action, and logs the sender."""
    scene = Scene(*settings().mavlink.commands)
    for operation in (1, 2, 3):
        assert scene.result(long(31010, operation, 1)) is CommandResult.DENIED
    assert scene.result(long(512, 253)) is CommandResult.ACCEPTED
    assert scene.did == []
    assert scene.notes[0].startswith(
        "COMMAND: denied: command 31010 (1.0, 1.0) from 255/190 by radio, unsigned: 'check'"
    )


def test_with_signing_only_signed_commands_are_executed() -> None:
    """Reading is a command too; and an accepted signing time is saved first."""
    scene = Scene(*ALL, signs=True)
    assert scene.result(long(31010, 1)) is CommandResult.DENIED
    assert scene.result(long(512, 253)) is CommandResult.DENIED
    assert scene.did == []
    assert scene.result(long(31010, 1), signed=True) is CommandResult.ACCEPTED
    assert scene.did == ["remember", "look"]


def test_the_status_line_is_sent_on_request() -> None:
    """One line with the array, on the link of the request."""
    line, ack = Scene("status").ask(long(512, 253))
    assert (line.severity, line.text) == (6, "A07 OK --------")
    assert ack.result == CommandResult.ACCEPTED


def test_a_heartbeat_on_request_has_the_status_word() -> None:
    """Like the periodic one."""
    scene = Scene("status")
    heartbeat, _ack = scene.ask(long(512, 0))
    assert status_word.decode(heartbeat.custom_mode) == {Slot.HOST: Level.OK}
    assert heartbeat.system_status == mavlink.MAV_STATE_ACTIVE
    assert scene.result(long(512, 0)) is CommandResult.TEMPORARILY_REJECTED


@pytest.mark.parametrize(("agents", "periodic"), [(8, 30), (30, 12), (100, 4)])
def test_requests_at_most_double_the_heartbeats_of_a_link(agents: int, periodic: int) -> None:
    """The budget does not limit heartbeats. A sender that floods one link does not use up the requests of another."""
    scene, sent = Scene("status"), 0
    scene.agents = agents
    for _ in range(60):
        sent += len(scene.ask(long(512, 0))) - 1
        scene.clock.advance(1.0)
    assert sent == periodic
    assert scene.result(long(512, 0)) is CommandResult.ACCEPTED
    assert scene.result(long(512, 0)) is CommandResult.TEMPORARILY_REJECTED
    assert scene.result(long(512, 0), link="cable") is CommandResult.ACCEPTED


def test_the_figures_of_the_computer_are_those_of_the_host_check() -> None:
    """Unknown values are marked as unknown."""
    computer, _ack = Scene("status").ask(long(512, 390))
    assert computer.cpu_combined == [42, *[255] * 9]
    assert computer.temperature_core == [127] * 8
    assert abs(computer.ram_usage - computer.ram_total / 2) <= 1
    assert computer.storage_usage == computer.storage_total == [2**32 - 1] * 4
    assert computer.fan_speed == [2**15 - 1] * 4
    nothing = responses.computer((), mono=1.5, utc=0.0)
    assert (nothing.cpu_combined, nothing.ram_usage, nothing.ram_total) == ([255] * 10, 2**32 - 1, 2**32 - 1)
    assert nothing.uptime == 1500


def test_disks_and_fans_are_those_of_the_host_check() -> None:
    """As the check reports them, in MiB and rpm; a hung disk is omitted."""
    disks = (
        DiskFact("/", 75.0, 5 * 2**30, total_bytes=20 * 2**30),
        DiskFact("/nas", 0.0, 0, problem="it hangs"),
        DiskFact("/data", 50.0, 2**30, total_bytes=2 * 2**30),
    )
    results = Host(settings()).run(world(host=FakeHost(disks=disks, fans_rpm=(1200, 0, 40_000))))
    units = [
        UnitState(unit, "host", Slot.HOST, Layer.COMPANION, result.level, result, Stamp(0.0, 0.0))
        for unit, result in results.items()
    ]
    computer = responses.computer(units, mono=1.0, utc=1.0)
    assert computer.storage_usage == [15 * 1024, 1024, 2**32 - 1, 2**32 - 1]
    assert computer.storage_total == [20 * 1024, 2 * 1024, 2**32 - 1, 2**32 - 1]
    assert computer.fan_speed == [1200, 0, 2**15 - 2, 2**15 - 1]


def test_stalled_checks_are_not_reported() -> None:
    """The dead man's switch applies to requests, too."""
    scene = Scene("status")
    scene.checks_alive = False
    sent = scene.ask(long(512, 0))
    assert [message.get_type() for message in sent] == ["COMMAND_ACK"]
    assert sent[0].result == CommandResult.FAILED


def details_of(sent: list[Any]) -> tuple[str, str]:
    """Fault id and text of the details among the sent messages."""
    decoded = [tunnel.decode(bytes(m.payload[: m.payload_length])) for m in sent if m.get_type() == "TUNNEL"]
    parts = [part for part in decoded if isinstance(part, tunnel.FaultDetail)]
    assert len(parts) == len(decoded)
    assert [part.part for part in parts] == list(range(parts[0].parts))
    return parts[0].fault, b"".join(part.text for part in parts).decode()


def test_the_details_of_a_fault_are_sent_in_parts_to_the_requester() -> None:
    """The newest open fault, or one by number; the numbers of the others are listed; long texts are truncated."""
    scene = Scene("details")
    scene.faults = (fault(3, 5.0), fault(17, 9.0, "x" * 5000))
    assert details_of(scene.ask(long(512, 385, 3))) == (
        "ab12-3",
        "nodes/node_1: node_1 is dead; open since 01:46:40 UTC; blocks topics; other open faults: 17",
    )
    sent = scene.ask(long(512, 385))
    name, text = details_of(sent)
    assert name == "ab12-17"
    assert len(sent) == tunnel.MAX_PARTS + 1
    assert text.startswith("nodes/node_1: xxx")
    assert {(m.target_system, m.target_component) for m in sent} == {(255, 190)}
    assert scene.result(long(512, 385, 4)) is CommandResult.FAILED


def test_checks_are_run_at_most_every_two_seconds() -> None:
    """A more frequent request is refused only temporarily."""
    scene = Scene("check")
    assert scene.result(long(31010, 1)) is CommandResult.ACCEPTED
    assert scene.result(long(31010, 1)) is CommandResult.TEMPORARILY_REJECTED
    scene.clock.advance(CHECK_EVERY_S)
    assert scene.result(long(31010, 1)) is CommandResult.ACCEPTED
    assert scene.did == ["look", "look"]


def test_a_fault_is_approved_by_its_number() -> None:
    """Unless it is not open, or two have that number (of two runs of PHM)."""
    scene = Scene("approve")
    scene.faults = (fault(3, 5.0), fault(17, 9.0))
    assert scene.result(long(31010, 2, 17)) is CommandResult.ACCEPTED
    assert scene.did == ["approve ab12-17"]
    assert scene.result(long(31010, 2, 4)) is CommandResult.FAILED
    scene.faults = (fault(5, 5.0), fault(5, 9.0))
    assert scene.result(long(31010, 2, 5)) is CommandResult.FAILED
    assert scene.did == ["approve ab12-17"]


def test_a_container_is_restarted_by_its_position() -> None:
    """Counted from 1, in the order of the configuration."""
    scene = Scene("restart")
    assert scene.result(long(31010, 3, 2)) is CommandResult.ACCEPTED
    assert scene.did == ["restart db for 255/190"]
    assert scene.result(long(31010, 3, 3)) is CommandResult.FAILED


def test_a_restart_of_another_container_than_the_chosen_one_is_denied() -> None:
    """The operator chose a name; after a reload its position may be another container's. 0 and NaN: no name is given."""
    scene = Scene("restart")
    assert scene.result(long(31010, 3, 2, container_hash("db"))) is CommandResult.ACCEPTED
    assert scene.result(long(31010, 3, 2, math.nan)) is CommandResult.ACCEPTED
    assert scene.did == ["restart db for 255/190"] * 2
    sent = scene.ask(long(31010, 3, 1, container_hash("db")))
    assert sent[0].result == CommandResult.DENIED
    assert details_of(sent)[1] == (
        "container 1 is app, not the chosen one: the configuration has changed, list the containers again"
    )
    assert len(scene.did) == 2


def test_a_restart_of_another_name_is_not_a_repetition() -> None:
    """The same position, chosen from another list."""
    scene = Scene("restart")
    assert scene.result(long(31010, 3, 1, container_hash("app"))) is CommandResult.ACCEPTED
    assert scene.result(long(31010, 3, 1, container_hash("db"), again=1)) is CommandResult.DENIED


@pytest.mark.parametrize(
    ("raised", "result"), [(Later("armed"), 1), (RuntimeError("no"), 4), (KeyError(), 4), (SystemExit(), 4)]
)
def test_an_impossible_action_is_refused_with_its_reason(raised: BaseException, result: int) -> None:
    """Temporarily or permanently."""
    scene = Scene("restart")
    scene.raises = raised
    assert scene.result(long(31010, 3, 1)) == result
    assert scene.did == []
    assert len(scene.notes) == 1


def test_a_disk_that_does_not_answer_rejects_a_signed_command_for_now() -> None:
    """Others are answered as before."""
    scene = Scene(*ALL, signs=True)
    scene.raises = TimeoutError("the disk hangs")
    assert scene.result(long(31010, 3, 1), signed=True) is CommandResult.TEMPORARILY_REJECTED
    assert scene.did == [] and "the disk hangs" in scene.notes[0]
    assert scene.result(long(512, 253), signed=True) is CommandResult.ACCEPTED


def test_a_repeated_command_is_answered_and_not_executed_again() -> None:
    """The acknowledgement was lost: the ground repeats it with a higher confirmation."""
    scene = Scene("restart")
    for again in range(3):
        assert scene.result(long(31010, 3, 1, again=again)) is CommandResult.ACCEPTED
    assert scene.did == ["restart app for 255/190"]
    assert scene.result(long(31010, 3, 1)) is CommandResult.ACCEPTED
    assert len(scene.did) == 2


def test_a_message_is_sent_periodically_until_it_is_disabled() -> None:
    """SET_MESSAGE_INTERVAL, on the link of the request."""
    scene = Scene("status")

    def lines(seconds: int) -> int:
        scene.sent.clear()
        for _ in range(seconds):
            scene.clock.advance(1.0)
            scene.handler.tick()
        return len([m for m, link in scene.sent if m.get_type() == "STATUSTEXT" and link == "radio"])

    assert scene.result(long(511, 253, 5e6)) is CommandResult.ACCEPTED
    assert lines(20) == 4
    scene.checks_alive = False
    assert lines(20) == 0
    scene.checks_alive = True
    assert scene.result(long(511, 253, 1e6)) is CommandResult.DENIED
    assert scene.result(long(511, 253, -1)) is CommandResult.ACCEPTED
    assert lines(20) == 0


def test_the_details_of_the_newest_fault_may_be_sent_periodically() -> None:
    """To the requester, while a fault is open; this needs the permission `details`."""
    scene = Scene("details")
    assert scene.result(long(511, 385, 1e7)) is CommandResult.ACCEPTED
    assert Scene("status").result(long(511, 385, 1e7)) is CommandResult.DENIED

    def details(seconds: int) -> list[str]:
        scene.sent.clear()
        for _ in range(seconds):
            scene.clock.advance(1.0)
            scene.handler.tick()
        sent = [m for m, link in scene.sent if m.get_type() == "TUNNEL" and link == "radio"]
        assert {(m.target_system, m.target_component) for m in sent} <= {(255, 190)}
        return [tunnel.decode(bytes(m.payload[: m.payload_length])).fault for m in sent]  # type: ignore[union-attr]

    assert details(30) == []
    scene.faults = (fault(3, 5.0),)
    assert details(30) == ["ab12-3"] * 3
    scene.faults = (fault(3, 5.0), fault(17, 9.0))
    assert details(10) == ["ab12-17"]


def test_a_flood_is_bounded_and_reported_once() -> None:
    """Commands above the limit are dropped unread."""
    scene = Scene("status")
    for n in range(1000):
        scene.handler.receive(scene.ground.received(long(512, 253, n)), "radio")
    assert len(scene.handler._waiting[False]) == SENDER_BURST <= MAX_WAITING
    scene.handler.tick()
    assert [note for note in scene.notes if "rate limit exceeded" in note] == [
        "COMMAND: 990 commands dropped: rate limit exceeded"
    ]


def test_a_flood_of_refused_commands_does_not_fill_the_log() -> None:
    """A few lines per minute at most, for any sender and result; the counts add up."""
    scene = Scene("status")
    for n in range(10 * 60):
        scene.clock.advance(0.1)
        scene.ask(long(512, 253) if n % 2 else long(31010, 3, 1), by=Sender(1 + n % 250, n // 250))
    scene.clock.advance(PERIOD_S)
    scene.handler.tick()
    assert len(scene.notes) <= LOGGED_PER_PERIOD + 3
    counted = [note for note in scene.notes if "not logged individually" in note]
    assert sum(int(note.split()[1]) for note in counted) + LOGGED_PER_PERIOD == 600
    assert max(map(len, scene.notes)) < 250


def test_an_executed_command_is_logged_in_any_flood() -> None:
    """So is each signed one, with its reason."""
    scene = Scene("restart", signs=False)
    for n in range(30):
        scene.clock.advance(0.5)
        scene.ask(long(31010, 1, n), by=Sender(n + 1, 190))
    scene.ask(long(31010, 3, 1))
    assert scene.notes[-1].startswith("COMMAND: accepted: restart container 1")
    signed = Scene("status", signs=True)
    for n in range(30):
        signed.clock.advance(1.0)
        signed.ask(long(31010, 3, 1), by=Sender(n + 1, 190))
    signed.ask(long(31010, 3, 1), signed=True)
    assert signed.notes[-1].startswith("COMMAND: denied: command 31010 (3.0, 1.0) from 255/190 by radio, signed")


def test_a_signed_command_is_answered_before_unsigned_ones() -> None:
    """Regardless of how many of these wait, also for the place of its answer on the link."""
    scene = Scene("restart", signs=True)
    for n in range(MAX_WAITING + 10):
        scene.clock.advance(1.0)
        scene.handler.receive(Sender(n + 1, 190).received(long(31010, 3, 1)), "radio")
    received = scene.ground.received(long(31010, 3, 1))
    received._signed = True
    scene.handler.receive(received, "radio")
    scene.handler.tick()
    acks = [message.result for message, _link in scene.sent if message.get_type() == "COMMAND_ACK"]
    assert acks[0] == CommandResult.ACCEPTED
    assert set(acks[1:]) == {CommandResult.DENIED}
    assert len(acks) == MAX_WAITING + 1
    assert max(scene.urgencies[:2]) < min(scene.urgencies[2:]), "the signed one's acknowledgement and its text"


@pytest.mark.parametrize("allowed", [True, False])
def test_the_answer_to_an_operator_has_a_text(allowed: bool) -> None:
    """What follows, or why not: MAVLink's result alone does not say it."""
    scene = Scene(*(["approve"] if allowed else []))
    scene.faults = (fault(17, 1.0),)
    sent = scene.ask(long(31010, 2, 17))
    assert [message.get_type() for message in sent] == ["COMMAND_ACK", "TUNNEL"]
    name, text = details_of(sent)
    assert name == "reply"
    assert (sent[0].result, "mavlink.commands" in text) == ((0, False) if allowed else (2, True))


def test_unsigned_senders_get_no_text_where_signing_is_on() -> None:
    """Anybody on the link can be one, and a text is six times as long as its acknowledgement."""
    sent = Scene("approve", signs=True).ask(long(31010, 2, 17))
    assert [message.get_type() for message in sent] == ["COMMAND_ACK"]


def test_the_ground_can_list_the_containers() -> None:
    """So that an operator restarts one by its name."""
    assert details_of(Scene("details").ask(long(512, 385, -1))) == ("containers", "1 app, 2 db")


def test_the_handler_answers_from_its_own_thread() -> None:
    """`receive` only queues; `close` ends the thread."""
    scene = Scene("status")
    scene.handler.start()
    scene.handler.receive(scene.ground.received(long(512, 253)), "radio")
    until(lambda: len(scene.sent) == 2, "the answer")
    scene.handler.close()
    assert not scene.handler._thread.is_alive()
