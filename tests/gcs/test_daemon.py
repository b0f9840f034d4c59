"""Real agents on loopback, received by the complete ground station: station, record and command line."""

from __future__ import annotations

import contextlib
import json
import os
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

import phm
from phm.core.clock import SystemClock
from phm.core.settings import MavlinkSettings
from phm.gcs.recorder import Recorder
from phm.gcs.station import COMPONENT, GroundStation
from phm.gcs.subscriber_queue import SubscriberQueue
from phm.runtime.daemon import Daemon
from phm.runtime.wiring import build_daemon
from phm.simulation.autopilot import SimulatedAutopilot
from phm.testing import settings
from phm.transport.dialect import mavlink
from phm.wire import json_log
from phm.wire.gcs_marker import MONITOR
from tests.fakes.mavlink import Sender, free_port, heartbeat, text
from tests.fakes.until import until
from tests.gcs.bench import Wire

ROOT = Path(phm.__file__).parents[1]
KEY = bytes(range(1, 33))


class SlowClock(SystemClock):
    """A companion computer without an RTC battery: years behind."""

    def utc(self) -> float:
        return super().utc() - 9e7


def agent(
    folder: Path,
    number: int,
    url: str,
    *,
    key: Path | None = None,
    engine: bool = False,
    commands: Sequence[str] = ("status", "details"),
) -> Daemon:
    """A PHM. engine: it has a container, and an engine that is not there. commands: `mavlink.commands`."""
    docker = {"docker": {"socket": f"unix://{folder}/none.sock"}, "containers": [{"name": "app"}]} if engine else {}
    made = settings(
        agent={"id": number},
        interval=1,
        state_dir=str(folder / f"state{number}"),
        run_dir=str(folder / f"run{number}"),
        log={"directory": str(folder / f"log{number}")},
        checks={"host": {"enabled": False}},
        mavlink={
            "endpoints": [{"url": url, "leads_to": "router", "budget": 0}],
            "heartbeat": 0.5,
            "refresh": 1,
            "signing": {"key": str(key) if key else None},
            "commands": list(commands),
        },
        **docker,
    )
    return build_daemon(made, SlowClock())


def endpoints(*urls: str, key: Path | None = None) -> MavlinkSettings:
    return MavlinkSettings.model_validate(
        {
            "endpoints": [{"url": url, "budget": 0} for url in urls],
            "component_id": COMPONENT,
            "signing": {"key": str(key) if key else None},
        }
    )


class Router:
    """Forwards what each peer of one UDP port sends to all others, as a router without rules does."""

    def __init__(self) -> None:
        self._sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._sock.bind(("127.0.0.1", 0))
        self._sock.settimeout(0.2)
        self.port = int(self._sock.getsockname()[1])
        self._peers: set[Any] = set()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join(60)
        self._sock.close()

    def _loop(self) -> None:
        while not self._stop.is_set():
            try:
                data, sender = self._sock.recvfrom(65535)
            except OSError:  # no data for a moment, or a peer that is gone
                continue
            self._peers.add(sender)
            for peer in self._peers - {sender}:
                with contextlib.suppress(OSError):
                    self._sock.sendto(data, peer)


class Scene:
    """Agent 7, whose engine is missing, agent 8 and the ground, all connected to one router."""

    def __init__(self, folder: Path, key: Path | None = None) -> None:
        self.router = Router()
        self.port, url = self.router.port, f"udpout:127.0.0.1:{self.router.port}"
        self.agents = {7: agent(folder, 7, url, key=key, engine=True), 8: agent(folder, 8, url, key=key)}
        clock = SystemClock()
        self.station = GroundStation(endpoints(url, key=key), 254, clock)
        self.queue = SubscriberQueue(clock)
        self.station.subscribe(self.queue)
        self.seen: list[dict[str, Any]] = []

    def start(self) -> None:
        self.station.start()
        for daemon in self.agents.values():
            daemon.start()

    def close(self) -> None:
        for daemon in self.agents.values():
            daemon.stop()
        self.station.close()
        self.router.close()

    def of(self, number: int) -> dict[str, Any]:
        agents = self.station.snapshot()[1].body["agents"]
        return next((one for one in agents if one["agent"] == number), {"how": None, "view": None, "line": None})

    def events(self, event: str) -> list[dict[str, Any]]:
        self.seen += [json.loads(item.line) for item in self.queue.take(0.0)]
        return [body for body in self.seen if body["event"] == event]


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    made = Scene(tmp_path)
    made.start()
    yield made
    made.close()


def test_two_real_agents_are_found_and_shown(scene: Scene, tmp_path: Path) -> None:
    """Slots, lines, views and the digest of agents whose clocks are years behind; one is stopped, one is killed."""
    until(lambda: scene.of(7)["how"] == "ERROR" and scene.of(8)["how"] in ("OK", "WARN"), "both agents")
    until(
        lambda: (one := scene.of(7))["slots"].get("2") == "ERROR" and any(bad["slot"] == 2 for bad in one["bad"]),
        "the line of the fault",
    )
    until(lambda: (view := scene.of(8)["view"]) and view["gcs"] and view["peers"] == {"7": "alive"}, "the view")
    until(lambda: scene.of(7)["received_by"] == [8], "the agents that receive it")
    until(lambda: (swarm := scene.station.snapshot()[1].body["swarm"]) and swarm["line"], "the swarm's line")
    until(lambda: all(one["presence"] == "alive" for one in (scene.of(7), scene.of(8))), "two agents in time")
    lines = [body for body in scene.events("text") if body["phm"] and body["agent"] == 7]
    assert any(body["text"].startswith("A07 FAIL 2 ") and body["severity_name"] == "CRITICAL" for body in lines)
    now = SystemClock().utc()
    assert all(abs(body["utc_s"] - now) < 600 for body in scene.seen)
    scene.agents[8].stop()
    until(lambda: scene.of(8)["how"] == "LEFT", "the goodbye")
    hub = scene.agents[7].components.probes.mavlink
    assert hub is not None
    hub.close()  # as a killed process: no goodbye
    until(lambda: scene.of(7)["how"] == "LOST", "the loss")
    assert (scene.of(7)["slots"], scene.of(7)["last_slots"]["2"]) == ({}, "ERROR")


def test_with_a_key_only_signed_frames_count(tmp_path: Path) -> None:
    """Agents with slow clocks take the time from the ground, and their tunnels are accepted; forged ones are not."""
    key = tmp_path / "key"
    key.write_text(KEY.hex())
    key.chmod(0o600)
    scene = Scene(tmp_path, key)
    scene.start()
    try:
        until(lambda: (view := scene.of(8)["view"]) and view["peers"], "a signed view")
        forger, sock = Sender(8, 193), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        forged = mavlink.MAVLink_tunnel_message(0, 0, 46193, 4, list(b"\x11\x01\x00\x09".ljust(128, b"\0")))
        for _ in range(20):
            sock.sendto(forger.frame(forged), ("127.0.0.1", scene.port))
        sock.sendto(forger.frame(text("marker", 7)), ("127.0.0.1", scene.port))
        until(lambda: any(body["text"] == "marker" for body in scene.events("text")), "the end of the forged frames")
        sock.close()
        assert all("9" not in body["peers"] for body in scene.events("view"))
    finally:
        scene.close()


def test_the_record_can_be_read_back(scene: Scene, tmp_path: Path) -> None:
    """Numbers without a gap, timestamps of the ground, a snapshot at the end; a truncated last line does not matter."""
    path = tmp_path / "record" / "flight.jsonl"
    book = Recorder(str(path), scene.station, SystemClock())
    book.start()
    until(lambda: scene.of(7)["how"] == "ERROR" and scene.of(8)["how"] is not None, "news")
    until(lambda: path.exists() and path.stat().st_size > 1000, "the file")
    book.close()
    with path.open("ab") as stream:
        stream.write(b'{"v":1,"run":"torn')
    events = list(json_log.read(path))
    news = [event for event in events if event["event"] not in ("snapshot", "received")]
    assert [event["seq"] for event in news] == list(range(news[0]["seq"], news[0]["seq"] + len(news)))
    assert events[-1]["event"] == "snapshot"
    assert {one["agent"] for one in events[-1]["agents"]} == {7, 8}
    monos = [event["mono"] for event in news]
    assert max(monos) - min(monos) < 600
    assert book.about() == ""


# ---------------------------------------------------------------- what the station sends


@pytest.fixture
def wired() -> Iterator[Callable[..., tuple[GroundStation, Wire]]]:
    made: list[tuple[GroundStation, Wire]] = []

    def make(*, silent: bool = False, pilot: bool = False) -> tuple[GroundStation, Wire]:
        port = free_port(socket.SOCK_DGRAM)
        station, wire = (
            GroundStation(endpoints(f"udpin:127.0.0.1:{port}"), 254, SystemClock(), silent=silent, pilot=pilot),
            Wire(port),
        )
        made.append((station, wire))
        station.start()
        until(lambda: station.snapshot()[1].body["links"], "the link")
        return station, wire

    yield make
    for station, wire in made:
        station.close()
        wire.sock.close()


def test_the_station_sends_heartbeats_like_a_ground_station(wired: Callable[..., tuple[GroundStation, Wire]]) -> None:
    """Type GCS, 254/190, and only heartbeats."""
    _, wire = wired()
    wire.send(Sender(7, 193).frame(heartbeat(1 << 30)))
    received = until(lambda: (wire.receive() + wire.receive() + wire.receive()) or None, "a heartbeat")
    assert {(one.get_type(), one.get_srcSystem(), one.get_srcComponent(), one.type) for one in received} == {
        ("HEARTBEAT", 254, 190, mavlink.MAV_TYPE_GCS)
    }


@pytest.mark.parametrize(("is_pilot", "mode"), [(False, MONITOR), (True, 0)])
def test_the_station_announces_its_end(
    wired: Callable[..., tuple[GroundStation, Wire]], is_pilot: bool, mode: int
) -> None:
    """Its heartbeats say that it is `phm gcs`, or with --pilot a ground station like others; the last one says POWEROFF."""
    station, wire = wired(pilot=is_pilot)
    wire.send(Sender(7, 193).frame(heartbeat(1 << 30)))
    first = until(lambda: wire.receive() or None, "a heartbeat")[0]
    assert (first.custom_mode, first.system_status) == (mode, mavlink.MAV_STATE_ACTIVE)
    station.close()
    until(lambda: any(one.system_status == mavlink.MAV_STATE_POWEROFF for one in wire.receive()), "the farewell")


def test_a_silent_station_sends_nothing(wired: Callable[..., tuple[GroundStation, Wire]]) -> None:
    """It still receives."""
    station, wire = wired(silent=True)
    sender = Sender(7, 193)
    wire.send(sender.frame(heartbeat(1 << 30)))
    until(lambda: station.snapshot()[1].body["agents"], "the agent")
    assert [wire.receive() for _ in range(8)] == [[]] * 8
    station.close()
    assert wire.receive() == []


def test_another_program_with_our_id_is_reported(wired: Callable[..., tuple[GroundStation, Wire]]) -> None:
    """Our own frames that a router echoes are not reported."""
    station, wire = wired()
    wire.send(Sender(7, 193).frame(heartbeat(1 << 30)))
    own = until(lambda: wire.receive() or None, "a heartbeat of ours")[0]
    wire.send(bytes(own.get_msgbuf()))
    wire.send(Sender(8, 193).frame(heartbeat(1 << 30)))
    until(lambda: len(station.snapshot()[1].body["agents"]) == 2, "a frame after the echo")
    assert station.snapshot()[1].body["problems"] == []
    wire.send(Sender(254, 190).frame(heartbeat(5, kind=mavlink.MAV_TYPE_GCS)))
    problems = until(lambda: station.snapshot()[1].body["problems"], "the problem")
    assert "--id" in problems[0]


def test_a_flood_does_not_affect_other_senders(wired: Callable[..., tuple[GroundStation, Wire]]) -> None:
    """Only frames of the flooding sender are dropped; garbage in between changes nothing."""
    station, wire = wired()
    loud, calm = Sender(9, 193), Sender(7, 193)

    def flood() -> bool:
        """On a busy machine the first frames may be too slow for one."""
        for number in range(600):
            wire.send(loud.frame(text(f"A09 FAIL 6 unit {number}", 2)))
            if number % 100 == 0:
                wire.send(os.urandom(64) + calm.frame(heartbeat(1 << 30 | number)))
        return bool(station.snapshot()[1].body["frames_refused"])

    until(flood, "refused frames")
    until(lambda: any(one["agent"] == 7 for one in station.snapshot()[1].body["agents"]), "the other agent")


@pytest.mark.parametrize("silent", [False, True], ids=["speaks", "silent"])
def test_an_autopilot_forwards_to_stations_that_send(silent: bool) -> None:
    """By ArduPilot's rule, which the simulated one follows. When its port closes, the hop is the ground's own link."""
    companion, ground = free_port(), free_port()
    vehicle = SimulatedAutopilot(7, f"tcpin:127.0.0.1:{companion}", f"tcpin:127.0.0.1:{ground}", armed=True)
    thread = threading.Thread(target=vehicle.run, daemon=True)
    thread.start()
    station = GroundStation(endpoints(f"tcp:127.0.0.1:{ground}"), 254, SystemClock(), silent=silent)
    station.start()
    sender = Sender(7, 193)

    def body() -> Any:
        return station.snapshot()[1].body

    try:
        with socket.create_connection(("127.0.0.1", companion), 60) as phm_socket:

            def speak(times: int) -> bool:
                for _ in range(times):
                    phm_socket.sendall(sender.frame(heartbeat(0x40025D55)))
                    time.sleep(0.15)  # its period, which is learned
                return bool(body()["autopilots"])

            until(lambda: speak(1), "the autopilot itself")
            if not silent:
                until(lambda: speak(1) and body()["agents"], "forwarded frames")
            speak(8)
            vehicle.armed = False
            # Sent after all forwarded frames, on the same stream.
            until(lambda: not body()["autopilots"]["7"]["armed"], "its next heartbeat")
            assert [one["name"] for one in body()["agents"]] == ([] if silent else ["A07"])
    finally:
        vehicle.stop()
        thread.join(60)
    until(lambda: body()["links"] and not body()["links"][0]["open"], "the loss of the link")
    if not silent:
        until(lambda: (hop := body()["agents"][0]["hop"]) and hop["name"] == "ground link", "the hop")
    station.close()
