"""MAVSDK as a ground station of a vehicle with PHM: the native library, and the gRPC client with its `mavsdk_server`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from phm.core.model import Level, Slot
from phm.wire import status_word, tunnel
from sitl.simulation.ground import Ground
from tests.fakes.until import until
from tests.interop.programs import Watcher
from tests.interop.vehicle import COMPONENT, ERROR, FAIL, FIXED, SYSTEM, WARN, Vehicle

Ends = Callable[[Watcher], Watcher]
REFRESH = "A07 FAIL 11------ 9 memory"


def url(vehicle: Vehicle) -> str:
    return f"tcpout://127.0.0.1:{vehicle.port}"


@pytest.fixture
def watcher(vehicle: Vehicle, ends: Ends, tmp_path: Path) -> Watcher:
    made = ends(Watcher("mavsdk_watch.py", tmp_path / "mavsdk", url(vehicle)))
    made.wait_news("ready")
    return made


def received(watcher: Watcher, severity: str, begin: str) -> bool:
    """Whether a status text of this severity with this prefix was received."""
    return any(record["text"].startswith(begin) for record in watcher.news("text", severity=severity))


@pytest.mark.parametrize(
    ("script", "vehicle"),
    [("mavsdk_watch.py", ""), ("mavsdk_watch.py", "a passphrase"), ("mavsdk_grpc_watch.py", "")],
    ids=["native", "native, signed", "gRPC"],
    indirect=["vehicle"],
)
def test_status_text_has_every_line_with_its_severity(
    vehicle: Vehicle, ends: Ends, tmp_path: Path, script: str
) -> None:
    """CRITICAL, ERROR, WARNING, NOTICE and INFO arrive with their severity, without any setting, and signed without a key."""
    watcher = ends(Watcher(script, tmp_path / "mavsdk", url(vehicle)))
    # Lines sent before MAVSDK knew the system and the program subscribed are lost.
    until(lambda: received(watcher, "INFO", REFRESH), REFRESH, lambda: watcher.news("text"))
    beside = Ground(f"tcp:127.0.0.1:{vehicle.port}", system=250)
    beside.start()  # For a new ground station the full state is sent again.
    try:
        until(lambda: received(watcher, "WARNING", WARN), WARN, lambda: watcher.news("text"))
        until(lambda: received(watcher, "ERROR", ERROR), ERROR, lambda: watcher.news("text"))
    finally:
        beside.stop()
    vehicle.break_container()
    until(lambda: received(watcher, "CRITICAL", FAIL), FAIL, lambda: watcher.news("text"))
    vehicle.repair_container()
    until(lambda: received(watcher, "NOTICE", FIXED), FIXED, lambda: watcher.news("text"))


def test_the_system_is_the_vehicle_and_phm_is_one_of_its_components(vehicle: Vehicle, watcher: Watcher) -> None:
    """One system, discovered by its autopilot, with both components; its type is the autopilot's, not PHM's."""

    def both() -> list[dict[str, object]]:
        watcher.say("look")
        return watcher.news("system", components=[1, COMPONENT], connected=True)

    seen = until(both, "both components", lambda: watcher.news("system"))[0]
    assert (seen["count"], seen["id"], seen["autopilot"]) == (1, SYSTEM, True)
    assert (seen["kind_of"], seen["vehicle"], seen["connected"]) == ("ARDUPILOT", "MULTICOPTER", True)


def test_the_status_word_is_part_of_the_heartbeat(vehicle: Vehicle, watcher: Watcher) -> None:
    """MAVSDK provides unmodified heartbeats, so an operator's program can read the word."""
    vehicle.break_container()

    def words() -> list[int]:
        heartbeats = watcher.news("message", name="HEARTBEAT", system=SYSTEM, component=COMPONENT)
        found = [
            int(heartbeat["fields"]["custom_mode"])
            for heartbeat in heartbeats
            if heartbeat["fields"]["system_status"] == 6
        ]
        return [word for word in found if status_word.decode(word).get(Slot.CONTAINER) is Level.ERROR]

    assert status_word.decode(until(words, "the word", lambda: watcher.news("message"))[0])[Slot.HOST] is Level.ERROR


def test_phm_changes_neither_arming_nor_the_type_of_the_vehicle(vehicle: Vehicle, watcher: Watcher) -> None:
    """While PHM's status word changes, MAVSDK still shows the autopilot's arming."""
    vehicle.pilot.armed = True
    watcher.wait_news("armed", value=True)
    vehicle.break_container()
    until(lambda: received(watcher, "CRITICAL", FAIL), FAIL)
    since = len(watcher.news("armed"))
    until(lambda: len(watcher.news("armed")) > since + 2, "more about arming")
    flags = [record["value"] for record in watcher.news("armed")]
    assert all(flags[flags.index(True) :]), "PHM's heartbeat disarmed the vehicle in MAVSDK"


def test_a_dead_autopilot_is_reported_by_phm_only(vehicle: Vehicle, ends: Ends, tmp_path: Path) -> None:
    """If PHM has its own link to the ground, MAVSDK accepts any component's heartbeat as a connection."""
    both = url(vehicle), f"tcpout://127.0.0.1:{vehicle.direct}"
    watcher = ends(Watcher("mavsdk_watch.py", tmp_path / "mavsdk", *both))
    watcher.wait_news("ready")
    vehicle.hang_autopilot()
    until(
        lambda: received(watcher, "ERROR", "A07 FAIL 10 autopilot: no heartbeat"),
        "the line",
        lambda: watcher.news("text"),
    )

    def heartbeats() -> int:
        return len(watcher.news("message", name="HEARTBEAT", component=COMPONENT))

    # MAVSDK considers a system lost after 3 s without a heartbeat; these come twice a second.
    before = heartbeats()
    until(lambda: heartbeats() >= before + 10, "ten more of PHM's heartbeats")
    looked = len(watcher.news("system"))

    def still_connected() -> bool:
        watcher.say("look")
        return any(seen["connected"] for seen in watcher.news("system")[looked:])

    until(still_connected, "a look that finds it connected", lambda: watcher.news("system"))


def test_commands_to_phm_are_acknowledged(vehicle: Vehicle, watcher: Watcher) -> None:
    """A line, details of a fault, and a refusal, each by MavlinkDirect, each answered by PHM."""
    until(lambda: received(watcher, "INFO", REFRESH), REFRESH, lambda: watcher.news("text"))
    watcher.say(f"{COMPONENT} 512 385 0")
    answer = watcher.wait_news("message", name="COMMAND_ACK", component=COMPONENT)["fields"]
    assert (answer["command"], answer["result"]) == (512, 0)
    detail = watcher.wait_news("message", name="TUNNEL", component=COMPONENT)["fields"]
    part = tunnel.decode(bytes(detail["payload"][: detail["payload_length"]]))
    assert isinstance(part, tunnel.FaultDetail)
    watcher.say(f"{COMPONENT} 31010 1 0")
    answers = until(
        lambda: [
            record["fields"]
            for record in watcher.news("message", name="COMMAND_ACK", component=COMPONENT)
            if record["fields"]["command"] == 31010
        ],
        "the refusal",
    )
    assert answers[0]["result"] == 2
