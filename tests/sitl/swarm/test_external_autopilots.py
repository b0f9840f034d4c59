"""Real autopilots instead of simulated ones: their addresses and start commands, and a session of ArduPilot replayed to
the link emulator.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from phm.simulation.mavlink_port import Port, mavlink
from sitl.simulation.ground import Ground
from sitl.simulation.link_emulator import LinkEmulator
from sitl.simulation.ports import Ports
from sitl.swarm import config, external_autopilots
from sitl.swarm.options import Options
from tests.fakes.ardupilot import ArduPilot, decoded, read, record
from tests.fakes.until import until

ARDUPILOT = Options(agents=3, autopilot="ardupilot", autopilot_path="/usr/bin/env")


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """PHM_SITL_TLOG names a recording of a real session, which is replayed instead."""
    real = os.environ.get("PHM_SITL_TLOG")
    if real:
        return Path(real)
    file = tmp_path_factory.mktemp("session") / "ardupilot.tlog"
    record(file, 1)
    return file


@pytest.fixture
def vehicle(session: Path) -> Iterator[ArduPilot]:
    made = ArduPilot(session)
    yield made
    made.stop()


@pytest.fixture
def air(vehicle: ArduPilot) -> Iterator[LinkEmulator]:
    url = f"tcp:127.0.0.1:{vehicle.serial_0.bound_port}"
    made = LinkEmulator(1, pilots={1: url}, host="127.0.0.1", ports=Ports())
    thread = threading.Thread(target=made.run, name="air", daemon=True)
    thread.start()
    yield made
    made.stop()
    thread.join(60)


# ---------------------------------------------------------------- the session


def test_a_session_has_the_form_of_a_telemetry_log(session: Path) -> None:
    """Monotonic timestamps, and valid frames of one vehicle's autopilot, whose heartbeat is ArduPilot's."""
    entries = read(session)
    stamps = [stamp for stamp, _ in entries]
    assert stamps == sorted(stamps)
    messages = [decoded(frame) for _, frame in entries]
    heartbeats = [
        message for message in messages if message.get_type() == "HEARTBEAT" and message.get_srcComponent() == 1
    ]
    assert {(heartbeat.autopilot, heartbeat.base_mode & ~128) for heartbeat in heartbeats} == {(3, 81)}
    assert {"STATUSTEXT", "SYSTEM_TIME"} <= {message.get_type() for message in messages}


def test_the_emulator_boots_it_by_connecting_and_forwards_its_session(air: LinkEmulator, vehicle: ArduPilot) -> None:
    """Ground and PHM receive its heartbeat, its texts, and messages of its own dialect; it receives both of them and
    the radio.
    """
    ground = Ground(f"tcp:127.0.0.1:{air.station.bound_port}")
    ground.start()
    phm = Port(f"tcp:{air.routers[1].partition(':')[2]}")
    seen: set[str] = set()
    heartbeat = mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3).pack(
        mavlink.MAVLink(None, srcSystem=1, srcComponent=193)
    )

    def all_received() -> bool:
        phm.send(heartbeat)
        for sock in phm.sockets():
            seen.update(message.get_type() for _, message in phm.receive(sock))
        received = {(message.get_type(), message.get_srcSystem()) for message in vehicle.received[0]}
        return (
            {"HEARTBEAT", "STATUSTEXT", "SYSTEM_TIME", "RADIO_STATUS", "UNKNOWN_152"} <= seen
            and (1, 1) in ground.heartbeats
            and any("ArduCopter" in line.text for line in ground.lines)
            and {("HEARTBEAT", 1), ("HEARTBEAT", 255), ("RADIO_STATUS", 51)} <= received
        )

    until(all_received, "all messages", lambda: seen)
    ground.stop()
    phm.close()


def test_a_command_from_the_ground_reaches_only_the_autopilot(air: LinkEmulator, vehicle: ArduPilot) -> None:
    """And not PHM, which is a separate component."""
    ground = Ground(f"tcp:127.0.0.1:{air.station.bound_port}")
    ground.start()
    phm = Port(f"tcp:{air.routers[1].partition(':')[2]}")
    seen: list[Any] = []
    until(lambda: (1, 1) in ground.heartbeats, "the heartbeat of the autopilot")

    def executed() -> bool:
        ground.arm(1, armed=True)
        for sock in phm.sockets():
            seen.extend(message for _, message in phm.receive(sock))
        return any(message.get_type() == "COMMAND_LONG" for message in vehicle.received[0])

    until(executed, "the command to reach the autopilot")
    assert not [message for message in seen if message.get_type() == "COMMAND_LONG"]
    ground.stop()
    phm.close()


# ---------------------------------------------------------------- addresses and start commands


def test_ardupilot_has_its_conventional_ports_and_ids() -> None:
    """Instance i on 5760 + 10 i with system id i + 1, and PHM on its serial port 1, which forwards nothing. With a frame, so that 4.7
    can be armed."""
    assert external_autopilots.urls(ARDUPILOT) == "1=tcp:127.0.0.1:5760,2=tcp:127.0.0.1:5770,3=tcp:127.0.0.1:5780"
    own = config.endpoints(ARDUPILOT, 3)[2]
    assert (own["url"], own["leads_to"]) == ("tcp:air:5782", "autopilot")
    parameters = dict(line.split() for line in external_autopilots.PARAMETER_LINES.splitlines() if line[0] != "#")
    assert parameters == {"SERIAL1_PROTOCOL": "2", "MAV2_OPTIONS": "2", "FRAME_CLASS": "1", "FRAME_TYPE": "0"}
    assert len(config.endpoints(Options(), 3)) == 2


def test_an_autopilots_container_belongs_to_the_swarm_and_the_emulators_network(tmp_path: Path) -> None:
    """So `down` finds it, and every instance has its conventional ports on one address."""
    (file,) = external_autopilots.write(ARDUPILOT, 2, tmp_path)
    made = yaml.safe_load(Path(file).read_text())["services"][external_autopilots.SERVICE]
    assert made["labels"] == {"phm.sitl.swarm": "${PHM_SWARM}"}
    assert made["network_mode"] == "container:${PHM_SWARM}-air-air-1"
    words = " ".join(made["entrypoint"])
    assert words.startswith("/opt/autopilot --model quad --instance 1 --sysid 2 ")
    assert "/usr/bin/env:/opt/autopilot:ro" in made["volumes"]
    assert external_autopilots.write(Options(), 2, tmp_path) == []


def test_px4_is_an_image_with_its_conventional_api_port() -> None:
    """Instance i sends to UDP 14540 + i; its container is started by the image's default command, or the given one."""
    options = Options(agents=2, autopilot="px4", autopilot_image="px4:sih", autopilot_command="run-px4 {instance} {id}")
    external_autopilots.check(options)
    assert external_autopilots.urls(options) == "1=udpin:127.0.0.1:14540,2=udpin:127.0.0.1:14541"
    made = external_autopilots.service(options, 2, Path("/p"))["services"][external_autopilots.SERVICE]
    assert (made["image"], made["entrypoint"]) == ("px4:sih", ["run-px4", "1", "2"])


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (Options(autopilot="ardupilot"), "needs --autopilot-path"),
        (Options(autopilot="ardupilot", autopilot_path="/no/such/file"), "there is no such file"),
        (Options(agents=11, autopilot="px4", autopilot_image="x"), "allowed are up to 10"),
    ],
    ids=["neither", "no file", "too many"],
)
def test_an_invalid_autopilot_is_rejected_before_anything_is_created(options: Options, said: str) -> None:
    """The message states what is needed."""
    with pytest.raises(ValueError, match=said):
        external_autopilots.check(options)
