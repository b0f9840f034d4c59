"""What is sent to the ground, and when: one line for each change, none without a change."""

from __future__ import annotations

from dataclasses import replace

import pytest

from phm.core.model import (
    ActionEvent,
    Fault,
    FaultClosed,
    FaultOpened,
    HoldChanged,
    Layer,
    Level,
    Outcome,
    Phase,
    Report,
    Result,
    Slot,
    Transition,
    UnitState,
)
from phm.reporters.base import ReporterContext
from phm.reporters.mavlink import MavlinkReporter
from phm.runtime.sections import reporter_settings
from phm.testing import FakeClock, settings
from phm.transport.dialect import mavlink
from phm.transport.mavlink_codec import Codec
from phm.transport.send_queue import SendQueue
from phm.wire import status_word
from tests.fakes.mavlink import FakePort, Sender, heartbeat
from tests.fakes.until import until


class Scene:
    """A reporter with units whose levels the test sets; events reach it in the tracker's order."""

    def __init__(self, *, agent: int = 1, **mavlink_settings: object) -> None:
        self.clock, self.port, self.alive = FakeClock(), FakePort(), True
        self.units: dict[str, UnitState] = {}
        for slot, name in ((Slot.CONTAINER, "container/app"), (Slot.NODES, "nodes/a"), (Slot.HOST, "host")):
            self.units[name] = UnitState(
                name, name, slot, Layer.ROS, Level.OK, Result(Level.OK, ""), self.clock.stamp()
            )
        self.settings = settings(agent={"id": agent}, mavlink=mavlink_settings)
        self.restart()

    def restart(self, requests: tuple[ActionEvent, ...] = ()) -> None:
        """A new PHM, with these requests to the operator from the one before."""
        context = ReporterContext(
            reporter_settings(self.settings),
            self.clock,
            "boot",
            lambda: tuple(self.units.values()),
            lambda: self.alive,
            dict,
            self.port,
            requests=requests,
        )
        built = MavlinkReporter.build(context)
        assert built is not None
        self.reporter = built

    def become(self, unit: str, level: Level, brief: str = "", *, blocked_by: str = "", by: str = "itself") -> None:
        """Change the level of a unit, with the events that the tracker sends, in its order."""
        old, now = self.units[unit], self.clock.stamp()
        fault = Fault("F1", unit, old.slot, old.layer, old.result, now, by=by)
        opens = level is Level.ERROR and not old.fault
        closes = bool(old.fault) and (level is Level.OK or bool(blocked_by))
        if opens:
            self.reporter.handle(FaultOpened(now, fault))
        if closes and blocked_by:
            self.reporter.handle(FaultClosed(now, replace(fault, outcome=Outcome.REATTRIBUTED, by=blocked_by)))
        name = "F1" if opens or (old.fault and not closes) else ""
        new = replace(old, level=level, result=Result(level, "", brief), blocked_by=blocked_by, fault=name)
        self.units[unit] = new
        self.reporter.handle(Transition(now, old.level, new, changed_text=old.level is level))
        if closes and not blocked_by:
            self.reporter.handle(FaultClosed(now, replace(fault, outcome=Outcome.RESOLVED)))

    def report(self) -> None:
        now = self.clock.stamp()
        self.reporter.handle(Report(now, 1, now, tuple(self.units.values())))

    def pass_time(self, seconds: float) -> None:
        for _ in range(round(seconds * 10)):
            self.clock.advance(0.1)
            self.reporter.tick()

    def running(self) -> Scene:
        """A scene after the first report and its refresh line, with no sent messages remembered."""
        self.reporter.tick()
        self.report()
        self.reporter.tick()
        self.port.sent.clear()
        return self

    def last_heartbeat(self, seconds: float = 2.1) -> object:
        self.pass_time(seconds)
        return self.port.heartbeats()[-1]


def status(scene: Scene) -> int:
    return int(scene.last_heartbeat().system_status)  # type: ignore[attr-defined]


def test_a_fault_is_reported_once_at_its_severity() -> None:
    """A lost mission function is CRITICAL, any other loss is ERROR, and neither is repeated as time passes."""
    scene = Scene().running()
    scene.become("nodes/a", Level.ERROR, "a dead")
    scene.become("host", Level.ERROR, "disk / 99%")
    scene.pass_time(100.0)
    lines = scene.port.lines()
    assert [line for line in lines if line[0] <= 5] == [(2, "A01 FAIL 6 a dead"), (3, "A01 FAIL 9 disk / 99%")]


def test_the_end_of_a_fault_names_its_cause() -> None:
    """One NOTICE, with the action that recovered it, or that it recovered without one."""
    scene = Scene().running()
    for by, words in (("restart", "restarted"), ("itself", "recovered")):
        scene.become("nodes/a", Level.ERROR, "a dead")
        scene.port.sent.clear()
        scene.become("nodes/a", Level.OK, by=by)
        assert scene.port.lines() == [(5, f"A01 OK 6 a {words}")]


def test_a_warning_and_its_end_are_each_reported_once() -> None:
    """WARNING once, then a NOTICE that it is over."""
    scene = Scene().running()
    scene.become("host", Level.WARN, "disk / 88%")
    scene.become("host", Level.OK)
    assert scene.port.lines() == [(4, "A01 WARN 9 disk / 88%"), (5, "A01 OK 9 cleared: disk / 88%")]


def test_a_changed_brief_is_reported() -> None:
    """A second network is lost while the first one still is: the operator gets a line; the same text is not sent again."""
    scene = Scene().running()
    scene.become("nodes/a", Level.ERROR, "a dead")
    scene.become("nodes/a", Level.ERROR, "a, b dead")
    scene.become("nodes/a", Level.ERROR, "a, b dead")
    assert [words for _, words in scene.port.lines()] == ["A01 FAIL 6 a dead", "A01 FAIL 6 a, b dead"]


def test_a_consequence_of_another_fault_is_not_reported() -> None:
    """STALE is silent, blocked or not; so is its end when no failure was sent."""
    scene = Scene().running()
    scene.become("nodes/a", Level.STALE, blocked_by="container/app")
    scene.become("nodes/a", Level.OK)
    scene.become("nodes/a", Level.STALE)
    assert scene.port.lines() == []


def test_an_unknown_period_repeats_no_alarm() -> None:
    """ERROR, STALE, ERROR of the same fault is one alarm."""
    scene = Scene().running()
    scene.become("nodes/a", Level.ERROR, "a dead")
    scene.become("nodes/a", Level.STALE)
    scene.become("nodes/a", Level.ERROR, "a dead")
    assert len(scene.port.lines()) == 1


def test_a_reattributed_fault_is_cleared() -> None:
    """It is reported as recovered when its unit is OK."""
    scene = Scene().running()
    scene.become("nodes/a", Level.ERROR, "a dead")
    scene.become("nodes/a", Level.STALE, blocked_by="container/app")
    scene.become("nodes/a", Level.OK)
    assert scene.port.lines() == [(2, "A01 FAIL 6 a dead"), (5, "A01 OK 6 cleared: a dead")]


@pytest.mark.parametrize(
    ("phase", "expected"),
    [
        (Phase.ADVISED, [(4, "A01 ADVISE 2 restart app")]),
        (Phase.EXPIRED, [(4, "A01 EXPIRED 2 restart app")]),
        (Phase.ESCALATED, [(2, "A01 GAVE UP 2 app exited")]),
        (Phase.STARTED, []),
        (Phase.DONE, []),
        (Phase.VERIFIED, []),
    ],
)
def test_only_actions_that_need_the_operator_are_reported(phase: Phase, expected: list[tuple[int, str]]) -> None:
    """A recommendation and giving up are lines; an action is reported by its result."""
    scene = Scene().running()
    scene.become("container/app", Level.ERROR, "app exited")
    scene.port.sent.clear()
    scene.reporter.handle(ActionEvent(scene.clock.stamp(), "F1", "container/app", "restart", "app", phase))
    assert scene.port.lines() == expected


def act(scene: Scene, phase: Phase, fault: str = "ab12-17") -> None:
    scene.reporter.handle(ActionEvent(scene.clock.stamp(), fault, "container/app", "restart", "app", phase))


def test_an_action_to_approve_has_its_number() -> None:
    """The number of the fault, by which the ground approves; a station that connects later gets it, too, until the
    fault ends.
    """
    scene = Scene().running()
    scene.become("container/app", Level.ERROR, "app exited")
    scene.port.sent.clear()
    act(scene, Phase.ADVISED)
    assert scene.port.lines() == [(4, "A01 ADVISE 2 restart app #17 60s")]
    scene.reporter.gcs_appeared()
    scene.pass_time(1.0)
    assert (4, "A01 ADVISE 2 restart app #17 60s") in scene.port.lines()
    act(scene, Phase.ESCALATED)
    assert scene.port.lines() == [(2, "A01 GAVE UP 2 app exited #17")]
    scene.become("container/app", Level.OK)
    scene.port.sent.clear()
    scene.reporter.gcs_appeared()
    scene.pass_time(6.0)
    assert not any("#17" in text for _, text in scene.port.lines())


def test_a_request_to_the_operator_survives_a_restart_of_phm() -> None:
    """Recovery does not ask again for a restored fault: a ground station that appears gets the request from the new PHM."""
    scene = Scene().running()
    scene.become("container/app", Level.ERROR, "app exited")
    asked = [ActionEvent(scene.clock.stamp(), "ab12-17", "container/app", "restart", "app", Phase.ADVISED)]
    scene.restart(requests=tuple(asked))
    scene.running()
    scene.reporter.gcs_appeared()
    scene.pass_time(1.0)
    assert (4, "A01 ADVISE 2 restart app #17 60s") in scene.port.lines()


def test_a_request_is_sent_again_while_its_unit_is_unknown() -> None:
    """The fault is still open, and the ground station that appears now has not received it."""
    scene = Scene().running()
    scene.become("container/app", Level.ERROR, "app exited")
    act(scene, Phase.ADVISED)
    scene.become("container/app", Level.STALE)
    scene.port.sent.clear()
    scene.reporter.gcs_appeared()
    scene.pass_time(1.0)
    assert (4, "A01 ADVISE 2 restart app #17 60s") in scene.port.lines()


@pytest.mark.parametrize("level", [Level.STALE, Level.ERROR])
def test_a_request_is_sent_again_however_many_units_come_before_its_unit(level: Level) -> None:
    """The limit of the full state is one for failures."""
    scene = Scene().running()
    scene.become("container/app", Level.ERROR, "app exited")
    act(scene, Phase.ADVISED)
    scene.become("container/app", level, "app exited")
    others = {f"container/{n}": replace(scene.units["container/app"], unit=f"container/{n}") for n in range(12)}
    scene.units = {**others, **scene.units}
    scene.port.sent.clear()
    scene.reporter.gcs_appeared()
    scene.pass_time(1.0)
    lines = scene.port.lines()
    assert lines.count((4, "A01 ADVISE 2 restart app #17 60s")) == 1
    assert [severity for severity, _ in lines].count(2) == (10 if level is Level.ERROR else 0)


@pytest.mark.parametrize(
    ("phase", "expected"),
    [
        (Phase.STARTED, []),
        (Phase.VERIFIED, [(5, "A01 OK 2 restart done: app")]),
        (Phase.FAILED, [(4, "A01 WARN 2 restart failed: app")]),
        (Phase.REFUSED, [(4, "A01 WARN 2 restart refused: app")]),
    ],
)
def test_the_result_of_an_operators_request_is_reported(phase: Phase, expected: list[tuple[int, str]]) -> None:
    """No fault is open, so no other line would report it."""
    scene = Scene().running()
    act(scene, phase, fault="")
    assert scene.port.lines() == expected


def test_the_refresh_is_sent_at_its_period_as_info() -> None:
    """From the first report on, one INFO line per period: the array and the worst unit."""
    scene = Scene(refresh=10).running()
    scene.become("nodes/a", Level.ERROR, "a dead")
    scene.port.sent.clear()
    scene.pass_time(30.5)
    assert scene.port.lines() == [(6, "A01 FAIL -1---0-- 6 a dead")] * 3


def test_the_refresh_period_depends_on_the_size_of_the_swarm() -> None:
    """Without `mavlink.refresh` the line is sent every 10 s in a small swarm, every 150 s in a large one."""
    scene = Scene().running()
    scene.pass_time(21.0)
    assert scene.port.lines() == [(6, "A01 OK -1---1--")] * 2
    scene.port.agents = 100
    scene.pass_time(10.0)  # the last one of the small swarm
    scene.port.lines()
    scene.pass_time(300.5)
    assert scene.port.lines() == [(6, "A01 OK -1---1--")] * 2


def test_heartbeats_carry_the_status_word() -> None:
    """Every `heartbeat` seconds: ONBOARD_CONTROLLER, no autopilot, no mode, the word of all slots."""
    scene = Scene(heartbeat=2).running()
    scene.become("nodes/a", Level.WARN, "a slow")
    scene.pass_time(20.05)
    heartbeats = scene.port.heartbeats()
    assert len(heartbeats) == 10
    heartbeat = heartbeats[-1]
    assert (heartbeat.type, heartbeat.autopilot, heartbeat.base_mode) == (18, 8, 0)
    levels = {Slot.CONTAINER: Level.OK, Slot.NODES: Level.WARN, Slot.HOST: Level.OK}
    assert status_word.decode(heartbeat.custom_mode) == levels


def test_the_system_status_is_the_severity() -> None:
    """BOOT before the first report, then ACTIVE, CRITICAL when degraded, EMERGENCY when the mission function is lost."""
    scene = Scene()
    scene.reporter.tick()
    assert scene.port.heartbeats()[-1].system_status == mavlink.MAV_STATE_BOOT
    scene.report()
    assert status(scene) == mavlink.MAV_STATE_ACTIVE
    scene.become("host", Level.ERROR, "disk / 99%")
    assert status(scene) == mavlink.MAV_STATE_CRITICAL
    scene.become("nodes/a", Level.ERROR, "a dead")
    assert status(scene) == mavlink.MAV_STATE_EMERGENCY
    scene.reporter.close()
    assert scene.port.heartbeats()[-1].system_status == mavlink.MAV_STATE_POWEROFF


def test_the_dead_mans_switch_silences_heartbeat_and_refresh() -> None:
    """When the scheduler stalls, no message claims that checks run; when it is back both are sent again."""
    scene = Scene(refresh=5).running()
    scene.alive = False
    scene.pass_time(30.0)
    assert scene.port.sent == []
    scene.alive = True
    scene.pass_time(0.2)
    assert sorted(message.get_type() for message in scene.port.sent) == ["HEARTBEAT", "STATUSTEXT"]


def test_a_new_ground_station_receives_the_full_state_once() -> None:
    """Heartbeat, each bad unit at its severity, the refresh; then nothing more for the same station."""
    scene = Scene().running()
    gcs = Sender(255, 190)
    scene.become("nodes/a", Level.ERROR, "a dead")
    scene.become("host", Level.WARN, "disk / 88%")
    scene.port.sent.clear()
    for _ in range(3):
        scene.port.receive(gcs.received(heartbeat(kind=mavlink.MAV_TYPE_GCS)))
        scene.pass_time(1.0)
    lines = scene.port.lines()
    assert lines == [
        (2, "A01 FAIL 6 a dead"),
        (4, "A01 WARN 9 disk / 88%"),
        (6, "A01 FAIL -1---0-- 6 a dead +1"),
    ]


def test_a_returning_ground_station_receives_the_full_state_again() -> None:
    """Silence for longer than `gcs_timeout` means that it missed the messages sent meanwhile."""
    scene = Scene(gcs_timeout=10).running()
    gcs = Sender(255, 190)
    scene.become("nodes/a", Level.ERROR, "a dead")
    for silence, expected in ((5.0, 1), (9.0, 0), (11.0, 1)):
        scene.pass_time(silence)
        scene.port.sent.clear()
        scene.port.receive(gcs.received(heartbeat(kind=mavlink.MAV_TYPE_GCS)))
        scene.pass_time(0.5)
        assert [severity for severity, _ in scene.port.lines()].count(2) == expected


def test_a_ground_station_that_announced_its_end_is_new_when_it_is_back() -> None:
    """However soon: the program was started again, and knows nothing."""
    scene = Scene().running()
    gcs, leaving = Sender(254, 190), heartbeat(kind=mavlink.MAV_TYPE_GCS)
    leaving.system_status = mavlink.MAV_STATE_POWEROFF
    full = []
    for message in (heartbeat(kind=mavlink.MAV_TYPE_GCS), leaving, heartbeat(kind=mavlink.MAV_TYPE_GCS)):
        scene.pass_time(5.0)
        scene.port.sent.clear()
        scene.port.receive(gcs.received(message))
        scene.pass_time(0.5)
        full.append(bool(scene.port.heartbeats()))
    assert full == [True, False, True]


def test_answers_of_a_swarm_are_spread() -> None:
    """Agents answer the same ground station one after another, by their number."""
    waits = []
    for agent in (1, 30, 81):
        scene = Scene(agent=agent).running()
        scene.port.receive(Sender(255, 190).received(heartbeat(kind=mavlink.MAV_TYPE_GCS)))
        before = scene.clock.mono()
        until(scene.port.lines, "the answer", step=lambda scene=scene: scene.pass_time(0.1))  # type: ignore[misc]
        waits.append(scene.clock.mono() - before)
    assert waits[0] < waits[1] < 1.1 < waits[2] < 2.0


@pytest.mark.parametrize(("system", "kind"), [(255, mavlink.MAV_TYPE_QUADROTOR), (1, mavlink.MAV_TYPE_GCS)])
def test_other_senders_are_not_ground_stations(system: int, kind: int) -> None:
    """Another vehicle, or a program on board that acts as a ground station, gets no answer."""
    scene = Scene().running()
    scene.port.receive(Sender(system, 190).received(heartbeat(kind=kind)))
    scene.pass_time(1.0)
    assert scene.port.lines() == []


def test_a_burst_of_changes_stays_within_the_budget_worst_first() -> None:
    """Through a real send queue: each unit's latest state is sent, mission functions before the rest."""
    scene = Scene().running()
    outbox, codec = SendQueue(scene.clock, 158.0), Codec(1, 193, lambda _: False)
    scene.port.to = lambda message, kind, key, urgency: outbox.put(message, codec.size(message), kind, key, urgency)
    template = scene.units["nodes/a"]
    for number in range(200):
        name = f"nodes/n{number}"
        scene.units[name] = replace(template, unit=name, slot=Slot.NODES if number % 2 else Slot.HOST)
        scene.become(name, Level.ERROR, f"n{number} dead")
        scene.become(name, Level.ERROR, f"n{number} gone")
    first = list(iter(outbox.take, None))
    assert {message.severity for message in [item.message for item in first]} == {2}
    assert all(item.message.text.endswith("gone") for item in first)
    scene.pass_time(10.0)
    later = list(iter(outbox.take, None))
    assert 10 * 158 * 0.8 < sum(item.size for item in later) <= 10 * 158 + 63


def test_a_flapping_unit_is_reported_as_such_and_again_when_it_is_stable() -> None:
    """Three failures in a minute, one warning, silence; then its state."""
    scene = Scene(refresh=600).running()
    for _ in range(10):
        scene.become("nodes/a", Level.ERROR, "a dead")
        scene.pass_time(2.0)
        scene.become("nodes/a", Level.OK)
        scene.pass_time(2.0)
    changes_sent = [words for severity, words in scene.port.lines() if severity < 6]
    assert changes_sent == ["A01 FAIL 6 a dead", "A01 OK 6 a recovered"] * 2 + [
        "A01 FAIL 6 a dead",
        "A01 WARN 6 flapping: a dead",
    ]
    scene.pass_time(31.0)
    assert scene.port.lines() == [(5, "A01 OK 6 a recovered")]
    scene.become("nodes/a", Level.ERROR, "a dead")
    assert scene.port.lines() == [(2, "A01 FAIL 6 a dead")]


def test_lost_events_are_compensated_at_the_refresh() -> None:
    """A queue that overflowed must not leave a fault unreported, nor a closed one listed."""
    scene = Scene(refresh=10).running()
    healthy = scene.units["nodes/a"]
    scene.units["nodes/a"] = replace(healthy, level=Level.ERROR, result=Result(Level.ERROR, "", "a dead"), fault="F9")
    scene.pass_time(10.5)
    assert (2, "A01 FAIL 6 a dead") in scene.port.lines()
    scene.units["nodes/a"] = healthy
    scene.pass_time(10.0)
    assert (5, "A01 OK 6 cleared: a dead") in scene.port.lines()


def test_no_reporter_is_built_without_endpoints() -> None:
    """An agent without MAVLink has no cost for it."""
    context = ReporterContext(reporter_settings(settings()), FakeClock(), "boot", tuple, lambda: True, dict, None)
    assert MavlinkReporter.build(context) is None


def test_a_change_over_a_bad_radio_is_followed_by_refreshes() -> None:
    """Its line may be lost on the radio link; the refresh is INFO and is not spoken. Over a good radio it is sent at
    its period.
    """
    scene = Scene(refresh=60).running()
    scene.become("nodes/a", Level.ERROR, "a dead")
    scene.pass_time(6.0)
    assert scene.port.lines() == [(2, "A01 FAIL 6 a dead")]
    radio = UnitState("radio", "radio", Slot.RADIO, Layer.LINK, Level.OK, Result(Level.OK, ""), scene.clock.stamp())
    scene.units["radio"] = radio
    scene.become("nodes/a", Level.OK)
    scene.port.sent.clear()
    scene.become("radio", Level.WARN, "radio: damaged packets")
    scene.pass_time(30.0)
    line = "A01 WARN 11 radio: damaged packets"
    again = "A01 WARN -1---1-- 11 radio: damaged packets"
    assert scene.port.lines() == [(4, line), (6, again), (6, again), (6, again)]


def test_a_hold_and_its_end_are_reported_once() -> None:
    """As NOTICE, since an operator requested it."""
    scene = Scene().running()
    now = scene.clock.stamp()
    for began in (True, False):
        scene.reporter.handle(HoldChanged(now, "app", began, "operator", "new firmware", 600.0, "app is on hold"))
    scene.pass_time(3.0)
    changes = [line for line in scene.port.lines() if line[0] <= 5]
    assert changes == [(5, "A01 HOLD 2 app 10 min: new firmware"), (5, "A01 HOLD 2 app released")]
