"""The links of a swarm: routers, simulated autopilots, radios to the ground and between agents, in one process.

``python -m sitl.simulation.link_emulator --agents 8`` listens on fixed ports of its own container
(`sitl.simulation.ports.INSIDE`): for each agent's PHM one for its router (TCP) and one for the agents' network (UDP),
one where ground stations connect (TCP), and the control socket, which accepts the requests of
`sitl.swarm.control.LinkEmulatorClient`: one JSON object per line.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import random
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from typing import Any

from phm.simulation.autopilot_model import AutopilotModel
from phm.simulation.mavlink_port import Port
from sitl.simulation.frames import Frame
from sitl.simulation.mesh import Mesh
from sitl.simulation.ports import INSIDE, Ports
from sitl.simulation.vehicle import Place, Vehicle

REST_S = 0.25
"""Longest sleep of the loop: orders to stop are seen within it."""
RETRY_S = 0.5
"""Pause before a real autopilot is called again."""
CONTROL_BYTES = 65536


class LinkEmulator:
    """Runs in one thread: `run` until `stop`. Raises OSError when a port is in use.

    pilots: URLs of real autopilots by agent; other agents have a simulated one. host, ports: the listening addresses.
    """

    def __init__(
        self,
        agents: int,
        *,
        pilots: dict[int, str] | None = None,
        seed: int = 0,
        host: str = "0.0.0.0",
        ports: Ports = INSIDE,
    ) -> None:
        now, chance = time.monotonic(), random.Random(seed)
        self._urls = pilots or {}
        numbers = range(1, agents + 1)
        self.vehicles = {
            number: Vehicle(number, now, chance, None if number in self._urls else AutopilotModel(number, now))
            for number in numbers
        }
        self.mesh = Mesh(numbers, chance)
        self.station = Port(f"tcpin:{host}:{ports.ground}")
        self._control = socket.create_server((host, ports.control))
        self._control.setblocking(False)
        self._asking: dict[socket.socket, bytes] = {}
        self._phm = {number: Port(f"tcpin:{host}:{ports.router_of(number)}") for number in numbers}
        self._peers = {number: _udp(host, ports.peers_of(number)) for number in numbers}
        self.routers = {number: f"tcpin:{host}:{port.bound_port}" for number, port in self._phm.items()}
        """Where each router listens: there it listens again after it was killed."""
        self._received_at: dict[int, Any] = {}
        self._pilots: dict[int, Port] = {}
        self._retry = dict.fromkeys(self._urls, now)
        self._stopping = threading.Event()

    @property
    def control_port(self) -> int:
        return int(self._control.getsockname()[1])

    def stop(self) -> None:
        self._stopping.set()

    def run(self) -> None:
        try:
            while not self._stopping.is_set():
                self._turn()
        finally:
            self._close()

    # ------------------------------------------------------------ one turn

    def _turn(self) -> None:
        watched = self._watched()
        readable, _, _ = select.select(list(watched), [], [], self._rest_s())
        for sock in readable:
            watched[sock](sock)
        now = time.monotonic()
        self._call_pilots(now)
        for vehicle in self.vehicles.values():
            vehicle.tick(now)
            self._emit(vehicle)
        for agent, data in self.mesh.tick(now):
            if agent in self._received_at:
                with contextlib.suppress(OSError):
                    self._peers[agent].sendto(data, self._received_at[agent])

    def _rest_s(self) -> float:
        moments = [vehicle.next_s() for vehicle in self.vehicles.values()]
        moments.append(self.mesh.next_s())
        soonest = min((moment for moment in moments if moment is not None), default=float("inf"))
        return min(REST_S, max(0.001, soonest - time.monotonic()))

    def _watched(self) -> dict[Any, Callable[[Any], None]]:
        found: dict[Any, Callable[[Any], None]] = {self._control: self._accept}
        found.update(dict.fromkeys(self._asking, self._asked))
        for sock in self.station.sockets():
            found[sock] = self._from_station
        for group, place in ((self._phm, "phm"), (self._pilots, "pilot")):
            for number, port in group.items():
                for sock in port.sockets():
                    found[sock] = self._from_on_board(number, port, place)  # type: ignore[arg-type]
        for number, peers in self._peers.items():
            found[peers] = self._from_peer(number)
        return found

    def _from_station(self, sock: Any) -> None:
        for _, message in self.station.receive(sock):
            frame = Frame.of(message)
            for vehicle in self.vehicles.values():
                if frame.target_system in (0, vehicle.number):
                    vehicle.take(time.monotonic(), "ground", frame)

    def _from_on_board(self, number: int, port: Port, place: Place) -> Callable[[Any], None]:
        def receive(sock: Any) -> None:
            for _, message in port.receive(sock):
                self.vehicles[number].take(time.monotonic(), place, Frame.of(message))

        return receive

    def _from_peer(self, number: int) -> Callable[[Any], None]:
        def receive(sock: Any) -> None:
            with contextlib.suppress(OSError):
                data, self._received_at[number] = sock.recvfrom(CONTROL_BYTES)
                self.mesh.take(time.monotonic(), number, data)

        return receive

    def _emit(self, vehicle: Vehicle) -> None:
        places: dict[Place, Port | None] = {
            "phm": self._phm.get(vehicle.number),
            "pilot": self._pilots.get(vehicle.number),
            "ground": self.station,
        }
        for place, raw in vehicle.out:
            port = places[place]
            if port is not None:
                port.send(raw)
        vehicle.out.clear()

    # ------------------------------------------------------------ changing sockets

    def _routers(self) -> None:
        """A killed router has no socket: connections are refused."""
        for number, vehicle in self.vehicles.items():
            if vehicle.router_off and number in self._phm:
                self._phm.pop(number).close()
            elif not vehicle.router_off and number not in self._phm:
                self._phm[number] = Port(self.routers[number])

    def _call_pilots(self, now: float) -> None:
        """A real autopilot may not have started yet, or may disconnect."""
        for number, url in self._urls.items():
            port = self._pilots.get(number)
            if port is not None and port.lost:
                self._pilots.pop(number).close()
            if number not in self._pilots and now >= self._retry[number]:
                self._retry[number] = now + RETRY_S
                with contextlib.suppress(OSError):
                    self._pilots[number] = Port(url)

    def _close(self) -> None:
        for port in (self.station, *self._phm.values(), *self._pilots.values()):
            port.close()
        for sock in (self._control, *self._asking, *self._peers.values()):
            sock.close()

    # ------------------------------------------------------------ control

    def _accept(self, _: Any) -> None:
        with contextlib.suppress(OSError):
            client, _ = self._control.accept()
            client.setblocking(False)
            self._asking[client] = b""

    def _asked(self, client: Any) -> None:
        try:
            data = client.recv(CONTROL_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        self._asking[client] += data
        line, newline, _ = self._asking[client].partition(b"\n")
        if data and not newline and len(line) < CONTROL_BYTES:
            return
        del self._asking[client]
        with contextlib.closing(client), contextlib.suppress(OSError):
            if newline:
                client.sendall(json.dumps(self.answer(line)).encode() + b"\n")

    def answer(self, line: bytes) -> dict[str, Any]:
        """The answer to one line of the control socket: ``{"error": words}`` for an invalid request."""
        try:
            words = json.loads(line)
            found = self._do(words.pop("do"), words)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            return {"error": f"{line.decode(errors='replace').strip()}: {error}"}
        return {"ok": True, **found}

    def _do(self, what: str, words: dict[str, Any]) -> dict[str, Any]:
        if what == "traffic":
            return {"agents": {number: self._traffic(number) for number in self.vehicles}}
        if what == "state":
            return {
                "state": {
                    "agents": {number: self._state(number) for number in self.vehicles},
                    "groups": self.mesh.groups,
                }
            }
        if what == "split":
            self.mesh.split(words["groups"])
            return {}
        number = words["agent"]
        if number not in self.vehicles:
            raise ValueError(f"there is no agent {number!r}: allowed are 1 to {len(self.vehicles)}")
        self._change(what, number, self.vehicles[number], words)
        return {}

    def _change(self, what: str, number: int, vehicle: Vehicle, words: dict[str, Any]) -> None:
        if what == "reset":
            vehicle.reset()
            self.mesh.reset(number)
        elif what == "autopilot":
            vehicle.order(time.monotonic(), words["order"], words["values"])
        elif what != "set":
            raise ValueError(f"nothing is known of {what!r}: allowed are set, reset, split, autopilot, traffic, state")
        elif words["link"] == "peers":
            self.mesh.change(number, words["values"])
        elif words["link"] in ("ground", "router", "autopilot"):
            vehicle.change(words["link"], words["values"])
        else:
            raise ValueError(f"there is no link {words['link']!r}: allowed are ground, peers, autopilot, router")
        self._routers()

    def _traffic(self, number: int) -> dict[str, int]:
        vehicle = self.vehicles[number]
        lost = sum(pipe.lost + pipe.full for pipe in (vehicle.up, vehicle.down))
        zero = dict.fromkeys(("to_ground", "phm_to_ground", "from_ground", "to_peers", "from_peers"), 0)
        return {**zero, **vehicle.counts, "ground_lost": lost, **self.mesh.counts(number)}

    def _state(self, number: int) -> dict[str, Any]:
        found = {**self.vehicles[number].state(), "peers": self.mesh.state(number)}
        port = self._phm.get(number)
        found["router"]["connected"] = 0 if port is None else len(port.peers)
        return found


def _udp(host: str, port: int) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind((host, port))
    made.setblocking(False)
    return made


def main(arguments: list[str] | None = None) -> int:
    words = argparse.ArgumentParser(
        prog="python -m sitl.simulation.link_emulator", description=__doc__.partition("\n")[0]
    )
    words.add_argument("--agents", type=int, default=8, help="how many (8)")
    words.add_argument("--pilots", default="", metavar="AGENT=URL,...", help="connections of real autopilots (none)")
    words.add_argument("--seed", type=int, default=0, help="of what is drawn at random (0)")
    chosen = words.parse_args(arguments)
    try:
        urls = {int(agent): url for agent, _, url in (pair.partition("=") for pair in chosen.pilots.split(",") if pair)}
        air = LinkEmulator(chosen.agents, pilots=urls, seed=chosen.seed)
    except (OSError, ValueError) as error:
        print(f"sitl.simulation.link_emulator: {error}", file=sys.stderr)
        return 1
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: air.stop())
    print(f"air of {chosen.agents} agents: ground tcp port {INSIDE.ground}, control {INSIDE.control}", flush=True)
    air.run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
