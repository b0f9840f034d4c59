"""The simulated autopilot sends what a recorded ArduPilot sends (tests/recorded/ardupilot)."""

from __future__ import annotations

import socket
import threading
from collections import Counter
from collections.abc import Iterator

import pytest

from phm.simulation.autopilot import SimulatedAutopilot
from phm.simulation.autopilot_model import BOOT_S, AutopilotModel
from phm.simulation.mavlink_port import mavlink, messages, parser
from tests.fakes.mavlink import Sender, free_port, heartbeat, text
from tests.fakes.recorded_flight import frames, source
from tests.fakes.until import until

STEP_S, LIMIT_S = 0.1, 60.0
STREAMS = {"SYSTEM_TIME", "ATTITUDE", "GLOBAL_POSITION_INT"}
COMMON = {"HEARTBEAT", "STATUSTEXT", "TIMESYNC", "PARAM_VALUE"}


def run(model: AutopilotModel, begin: float, end: float, port: str = "companion") -> list[tuple[float, str, str]]:
    """Time, type and state or text of everything that it sends."""
    decoder, found = parser(), []
    for step in range(round((end - begin) / STEP_S)):
        now = begin + step * STEP_S
        model.booted(now)
        raw = b"".join([*model.due(now), *model.due_on(now, port)])
        found += [(now, *words(message)) for message in messages(decoder, raw)] if raw else []
    return found


def words(message: object) -> tuple[str, str]:
    kind = message.get_type()  # type: ignore[attr-defined]
    more = {"HEARTBEAT": "system_status", "STATUSTEXT": "text"}.get(kind)
    return kind, str(getattr(message, more)) if more else ""


def command(number: int, *values: float) -> object:
    filled = [*values, *[0.0] * (7 - len(values))]
    return Sender(255, 190).received(mavlink.MAVLink_command_long_message(3, 1, number, 0, *filled))


def recorded(name: str) -> list[tuple[float, str, str]]:
    decoder = parser()
    return [
        (at, *words(message))
        for at, frame in frames(name)
        if source(frame) == (1, 1)
        for message in messages(decoder, frame)
    ]


def test_streams_are_off_by_default_as_recorded() -> None:
    """Only once, when the link opens, a real one sends SYS_STATUS, and its home when it is set."""
    real = {kind for _, kind, _ in recorded("hang_reboot_companion.tlog.gz")}
    assert real >= COMMON
    assert not STREAMS & real
    assert {kind for _, kind, _ in run(AutopilotModel(3, 0.0), 0.0, 40.0)} == COMMON


def test_rates_are_as_recorded() -> None:
    """Heartbeats every second, TIMESYNC every ten, from second 10 after the start."""
    real = Counter(kind for at, kind, _ in recorded("hang_reboot_companion.tlog.gz") if 4.5 <= at < 44.5)
    ours = Counter(kind for at, kind, _ in run(AutopilotModel(3, 0.0), 0.0, 50.0) if 9.5 <= at < 49.5)
    for kind in ("HEARTBEAT", "TIMESYNC"):
        assert ours[kind] == pytest.approx(real[kind], abs=1)


def start(events: list[tuple[float, str, str]], begin: float) -> list[tuple[float, str]]:
    """When each state of the heartbeat begins, and the text at the end of the start; seconds after `begin`."""
    found: list[tuple[float, str]] = []
    for at, _, more in events:
        new = more in ("1", "3", "ArduPilot Ready") and more not in [word for _, word in found]
        if at > begin and new:
            found.append((at - begin, more))
    return found


def test_a_reboot_is_as_recorded() -> None:
    """Six seconds without a frame, then heartbeats with BOOT, the text, and STANDBY, at the times of the real one."""
    model = AutopilotModel(3, 0.0)
    run(model, 0.0, 20.0)
    model.reboot(20.0)
    ours, theirs = start(run(model, 20.0, 32.0), 20.0), start(recorded("hang_reboot_companion.tlog.gz"), 111.2)
    assert [word for _, word in ours] == [word for _, word in theirs] == ["1", "ArduPilot Ready", "3"]
    for (mine, _), (real, _) in zip(ours, theirs, strict=True):
        assert mine == pytest.approx(real, abs=0.5)
    assert run(AutopilotModel(3, 0.0), 0.0, 0.0) == []


def test_streams_can_be_requested_on_one_port() -> None:
    """By interval or by the older stream request; a reboot ends them."""
    model = AutopilotModel(3, 0.0)
    accepted = model.handle(0.0, command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 2, 1e6), "companion")
    assert messages(parser(), accepted[0].frame)[0].result == mavlink.MAV_RESULT_ACCEPTED
    counts = Counter(kind for _, kind, _ in run(model, 1.0, 11.0))
    assert counts["SYSTEM_TIME"] == 10
    assert not STREAMS & {kind for _, kind, _ in run(model, 11.0, 15.0, "ground")}
    request = mavlink.MAVLink_request_data_stream_message(3, 1, mavlink.MAV_DATA_STREAM_ALL, 2, 1)
    model.handle(15.0, Sender(255, 190).received(request), "ground")
    assert {kind for _, kind, _ in run(model, 15.0, 17.0, "ground")} >= STREAMS
    model.handle(17.0, command(mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, 2, -1), "companion")
    assert not STREAMS & {kind for _, kind, _ in run(model, 17.0, 19.0)}
    model.reboot(19.0)
    assert not STREAMS & {kind for _, kind, _ in run(model, 19.0, 30.0, "ground")}


def test_one_message_can_be_requested() -> None:
    """The simulated autopilot acknowledges MAV_CMD_REQUEST_MESSAGE and sends the message to the sender alone."""
    answers = AutopilotModel(3, 0.0).handle(5.0, command(mavlink.MAV_CMD_REQUEST_MESSAGE, 2))
    assert [messages(parser(), answer.frame)[0].get_type() for answer in answers] == ["COMMAND_ACK", "SYSTEM_TIME"]
    assert not any(answer.everyone for answer in answers)


@pytest.fixture
def pilot() -> Iterator[SimulatedAutopilot]:
    companion, ground = (f"tcpin:127.0.0.1:{free_port()}" for _ in range(2))
    made = SimulatedAutopilot(7, companion, ground, reboot_s=0.5)
    thread = threading.Thread(target=made.run, daemon=True)
    thread.start()
    yield made
    made.stop()
    thread.join(60)


def test_a_reboot_closes_tcp_connections(pilot: SimulatedAutopilot) -> None:
    """New ones are refused until it is over."""
    port = pilot.companion.bound_port
    with socket.create_connection(("127.0.0.1", port), LIMIT_S) as phm:
        until(lambda: phm.recv(1000), "a heartbeat")
        pilot.reboot()
        until(lambda: not phm.recv(1000), "the end of the connection")

    def again() -> bool:
        try:
            with socket.create_connection(("127.0.0.1", port), 10) as phm:
                return bool(phm.recv(1000))
        except OSError:
            return False

    until(again, "a connection after the reboot")
    assert BOOT_S == 6.0


def test_frames_that_arrive_during_a_hang_are_forwarded_in_one_burst(pilot: SimulatedAutopilot) -> None:
    """As recorded: eleven lines and heartbeats of 12 s within 20 ms."""
    sender, decoder, seen = Sender(7, 193), parser(), list[str]()
    with (
        socket.create_connection(("127.0.0.1", pilot.companion.bound_port), LIMIT_S) as phm,
        socket.create_connection(("127.0.0.1", pilot.ground.bound_port), LIMIT_S) as ground,
    ):

        def listen() -> list[str]:
            found = [message for message in messages(decoder, ground.recv(4000)) if message.get_srcComponent() == 193]
            seen.extend(message.text for message in found if message.get_type() == "STATUSTEXT")
            return seen

        ground.sendall(Sender(255, 190).frame(heartbeat(kind=6)))

        def first() -> list[str]:
            phm.sendall(sender.frame(text("before")))
            return listen()

        until(first, "the first line")
        pilot.hung = True
        before = len(seen)
        for number in range(5):
            phm.sendall(sender.frame(text(f"A07 FAIL {number}")))
        pilot.hung = False
        until(lambda: "A07 FAIL 4" in listen(), "the last line")
        assert [line for line in seen[before:] if line != "before"] == [f"A07 FAIL {number}" for number in range(5)]
