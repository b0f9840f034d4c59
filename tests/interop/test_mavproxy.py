"""MAVProxy as ground station and as router, between the operator and a vehicle with PHM."""

from __future__ import annotations

import json
import socket
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from phm.core.model import Level, Slot
from phm.simulation.mavlink_port import mavlink
from sitl.simulation.ground import Ground
from tests.fakes.mavlink import Sender, free_port, text
from tests.fakes.until import until
from tests.interop.programs import Mavproxy, Program
from tests.interop.vehicle import COMPONENT, ERROR, FAIL, FIXED, SYSTEM, WARN, Vehicle

ONLINE = f"online system {SYSTEM}"
PASSPHRASE = "over-the-hills-and-far-away"
OTHER = 250
"""System id of a second ground station; MAVProxy is 255."""
Ends = Callable[[Mavproxy], Mavproxy]


class Asking(Ground):
    """A ground station that sends commands, and keeps the answers."""

    def __init__(self, url: str) -> None:
        super().__init__(url, system=OTHER)
        self.answers: list[Any] = []

    def ask(self, component: int, command: int, first: float) -> None:
        self._send(mavlink.MAVLink_command_long_message(SYSTEM, component, command, 0, first, 0, 0, 0, 0, 0, 0))

    def _take(self, message: Any) -> None:
        super()._take(message)
        if message.get_type() in ("COMMAND_ACK", "ONBOARD_COMPUTER_STATUS"):
            self.answers.append(message)


@pytest.fixture
def proxy(vehicle: Vehicle, ends: Ends, tmp_path: Path) -> Callable[..., Mavproxy]:
    """Start a MAVProxy on the vehicle's ground port, with these arguments."""
    return lambda *words: ends(Mavproxy(tmp_path / "proxy", f"--master=tcp:127.0.0.1:{vehicle.port}", *words))


@pytest.fixture
def behind(proxy: Callable[..., Mavproxy]) -> Iterator[tuple[Mavproxy, Asking]]:
    """A MAVProxy with `--out`, and a ground station behind it."""
    port = free_port(socket.SOCK_DGRAM)
    ground = Asking(f"udpin:127.0.0.1:{port}")
    ground.start()
    out = proxy("--non-interactive", "--out", f"127.0.0.1:{port}")
    out.wait_for(ONLINE)
    yield out, ground
    ground.stop()


def test_the_console_shows_phm_after_target_component_is_set_to_0(
    vehicle: Vehicle, proxy: Callable[..., Mavproxy]
) -> None:
    """By default it shows only the autopilot's text, from the moment when it knows the autopilot."""
    console = proxy()
    console.wait_for(ONLINE)
    beside = Ground(f"tcp:127.0.0.1:{vehicle.port}", system=OTHER)
    beside.start()
    try:
        vehicle.break_container()
        until(lambda: [line for line in beside.lines if line.text.startswith(FAIL)], "PHM's line on this port")
        # The autopilot's answer was sent after the line, on the same connection.
        beside.arm(SYSTEM, armed=True)
        console.wait_for("ARMED")
        assert not [line for line in console.texts() if line.startswith(FAIL)]
        console.say("set target_component 0")
        console.say("set target_component")
        console.wait_for("target_component 0")
        vehicle.repair_container()
        console.wait_for(f"AP: {FIXED}")
    finally:
        beside.stop()


def test_a_target_system_on_the_command_line_shows_all_severities(
    vehicle: Vehicle, proxy: Callable[..., Mavproxy]
) -> None:
    """With `--target-system` nothing needs to be typed; INFO, the refresh, is shown like an alarm."""
    console = proxy("--non-interactive", f"--target-system={SYSTEM}")
    console.wait_for("Mode LOITER")
    for line in (ERROR, WARN, "A07 FAIL 11------ 9 memory"):
        console.wait_for(f"AP: {line}")
    vehicle.break_container()
    console.wait_for(f"AP: {FAIL}")
    vehicle.repair_container()
    console.wait_for(f"AP: {FIXED}")


def test_the_setting_has_no_effect_before_the_autopilot_is_known(
    proxy: Callable[..., Mavproxy], vehicle: Vehicle
) -> None:
    """With `--cmd` it is overwritten by the first heartbeat of the autopilot; typed after that, it stays."""
    console = proxy("--cmd", "set target_component 0")
    console.wait_for(ONLINE)
    console.say("set target_component")
    console.wait_for("target_component 1")
    console.say(f"vehicle {SYSTEM}:0")
    console.say("set target_component")
    console.wait_for("target_component 0")
    vehicle.break_container()
    console.wait_for(f"AP: {FAIL}")


def test_phm_changes_neither_mode_nor_arming_nor_acknowledgements(
    vehicle: Vehicle, proxy: Callable[..., Mavproxy]
) -> None:
    """PHM's status word is in the mode field, and a command to all components has one answer, the autopilot's."""
    console = proxy(f"--target-system={SYSTEM}")
    console.wait_for("Mode LOITER")
    console.wait_for(f"Detected vehicle {SYSTEM}:{COMPONENT}")
    console.say("arm throttle")
    console.wait_for("COMMAND_ACK: COMPONENT_ARM_DISARM: ACCEPTED")
    console.wait_for("ARMED")
    word = vehicle.status_word()
    vehicle.break_container()
    console.wait_for(f"AP: {FAIL}")
    until(lambda: vehicle.status_word() != word, "another status word")
    console.say("disarm")
    console.wait_for("DISARMED")
    assert len(console.printed("Mode ")) == 1, "the mode changed"
    answers = console.printed("COMMAND_ACK: COMPONENT_ARM_DISARM")
    assert len(answers) == 2 and all(line.endswith("ACCEPTED") for line in answers)


def test_only_the_selected_vehicle_is_shown(vehicle: Vehicle, proxy: Callable[..., Mavproxy]) -> None:
    """Lines of another agent on the same port are shown after the console is switched to that agent."""
    console = proxy(f"--target-system={SYSTEM}")
    console.wait_for(f"AP: {ERROR}")
    other = Sender(8, COMPONENT)
    with socket.create_connection(("127.0.0.1", vehicle.companion)) as companion:
        companion.sendall(other.frame(text("A08 FAIL 6 node_1 dead", 2)))
        vehicle.break_container()  # reported later, by the same route
        console.wait_for(f"AP: {FAIL}")
        console.say("vehicle 8:0")
        console.say("set target_system")
        console.wait_for("target_system 8")
        companion.sendall(other.frame(text("A08 OK 6 node_1 recovered", 5)))
        console.wait_for("AP: A08 OK 6")
    assert not [line for line in console.texts() if line.startswith("A08 FAIL")]


def test_an_operator_commands_phm_by_its_component(vehicle: Vehicle, proxy: Callable[..., Mavproxy]) -> None:
    """`long` goes to the target component; a command without permission is DENIED, and the console says so."""
    console = proxy(f"--target-system={SYSTEM}")
    console.wait_for("Mode LOITER")
    console.say(f"set target_component {COMPONENT}")
    console.say("long USER_1 1")
    console.wait_for("COMMAND_ACK: USER_1: DENIED")


@pytest.mark.parametrize("vehicle", [PASSPHRASE], indirect=True)
def test_the_passphrase_of_mavproxy_gives_the_key_of_phm(vehicle: Vehicle, proxy: Callable[..., Mavproxy]) -> None:
    """Signed lines are shown with and without the key; a command is accepted only with it."""
    console = proxy(f"--target-system={SYSTEM}")
    console.wait_for("Mode LOITER")
    console.wait_for(f"AP: {ERROR}")
    console.say(f"set target_component {COMPONENT}")
    console.say("long USER_1 1")
    console.wait_for("COMMAND_ACK: USER_1: DENIED")
    console.say(f"signing key {PASSPHRASE}")
    console.wait_for("Setup signing key")
    console.say("long USER_1 1")
    console.wait_for("COMMAND_ACK: USER_1: ACCEPTED")
    console.say("long USER_1 2 17")  # permitted; there is no fault 17
    console.wait_for("COMMAND_ACK: USER_1: FAILED")
    vehicle.break_container()
    console.wait_for(f"AP: {FAIL}")


def test_a_ground_station_behind_it_receives_everything_from_phm(
    vehicle: Vehicle, behind: tuple[Mavproxy, Asking]
) -> None:
    """Status word and lines pass `--out` unchanged, although its own console does not show them."""
    console, ground = behind
    vehicle.break_container()
    line = until(lambda: [line for line in ground.lines if line.text.startswith(FAIL)], "the line")[0]
    assert (line.system, line.component, line.severity) == (SYSTEM, COMPONENT, 2)
    until(lambda: any(word.levels.get(Slot.CONTAINER) is Level.ERROR for word in list(ground.words)), "the word")
    change = next(word for word in list(ground.words) if word.levels.get(Slot.CONTAINER) is Level.ERROR)
    assert (change.system, change.component, change.system_status) == (SYSTEM, COMPONENT, mavlink.MAV_STATE_EMERGENCY)
    assert change.levels[Slot.HOST] is Level.ERROR
    assert not [line for line in console.texts() if line.startswith(FAIL)]


def test_a_ground_station_behind_it_is_received_and_answered(vehicle: Vehicle, behind: tuple[Mavproxy, Asking]) -> None:
    """PHM receives its heartbeat, sends it the full state, and acknowledges its request to it alone."""
    _, ground = behind
    until(lambda: [line for line in ground.lines if line.text.startswith(ERROR)], "the full state")
    until(lambda: (OTHER, 190) in vehicle.senders(), "its heartbeat at PHM", lambda: vehicle.senders())
    ground.ask(COMPONENT, mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_ONBOARD_COMPUTER_STATUS)
    kinds = {"COMMAND_ACK", "ONBOARD_COMPUTER_STATUS"}
    until(
        lambda: kinds <= {message.get_type() for message in list(ground.answers)}, "the answers", lambda: ground.answers
    )
    for message in ground.answers:
        assert (message.get_srcSystem(), message.get_srcComponent()) == (SYSTEM, COMPONENT)
    answer = next(message for message in ground.answers if message.get_type() == "COMMAND_ACK")
    assert (answer.command, answer.result) == (mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAV_RESULT_ACCEPTED)
    assert (answer.target_system, answer.target_component) == (OTHER, 190)


def test_two_ground_stations_behind_it_do_not_receive_each_other(
    vehicle: Vehicle, proxy: Callable[..., Mavproxy]
) -> None:
    """Each is received by PHM and receives the vehicle; `--out` does not connect the agents of a swarm."""
    ports = [free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_DGRAM)]
    grounds = [Ground(f"udpin:127.0.0.1:{port}", system=OTHER + place) for place, port in enumerate(ports)]
    for ground in grounds:
        ground.start()
    try:
        proxy("--non-interactive", *(f"--out=127.0.0.1:{port}" for port in ports))
        both = {(OTHER, 190), (OTHER + 1, 190)}
        until(lambda: both <= vehicle.senders(), "both heartbeats at PHM", lambda: vehicle.senders())
        for ground in grounds:
            before = len(ground.lines)
            until(lambda: len(ground.lines) > before, "the refresh")  # noqa: B023 - called immediately
            assert not both & set(ground.heartbeats)
    finally:
        for ground in grounds:
            ground.stop()


def test_phm_gcs_behind_it_shows_the_vehicle(
    vehicle: Vehicle, proxy: Callable[..., Mavproxy], ends: Callable[[Program], Program], tmp_path: Path
) -> None:
    """Started beside the pilot's MAVProxy without a list of agents: it shows slots and lines, and PHM receives it."""
    port = free_port(socket.SOCK_DGRAM)
    words = ["-m", "phm.cli", "gcs", "--json", f"udpin:127.0.0.1:{port}"]
    station = ends(Program(words, tmp_path, Path(sys.executable)))
    station.wait_for('"event":"link"')
    proxy("--non-interactive", "--out", f"127.0.0.1:{port}").wait_for(ONLINE)
    until(lambda: (254, 190) in vehicle.senders(), "its heartbeat at PHM", lambda: vehicle.senders())
    vehicle.break_container()

    def records(event: str) -> list[dict[str, Any]]:
        news = [json.loads(line) for line in list(station.lines)]
        return [record for record in news if record["event"] == event and record.get("agent") == SYSTEM]

    until(
        lambda: [record for record in records("text") if record["text"].startswith(FAIL)],
        "the line",
        station.last_lines,
    )
    until(
        lambda: [record for record in records("slots") if record["slots"]["2"] == "ERROR"],
        "the slot",
        station.last_lines,
    )


def test_a_dead_autopilot_is_reported_by_phm_and_by_the_link(vehicle: Vehicle, proxy: Callable[..., Mavproxy]) -> None:
    """If PHM has its own link to the ground, its heartbeats are not taken for the autopilot's."""
    console = proxy(f"--master=tcp:127.0.0.1:{vehicle.direct}", f"--target-system={SYSTEM}")
    console.wait_for("Mode LOITER")
    console.wait_for(f"Detected vehicle {SYSTEM}:{COMPONENT}")
    vehicle.hang_autopilot()
    console.wait_for("AP: A07 FAIL 10 autopilot: no heartbeat")
    console.wait_for("link 1 down")
