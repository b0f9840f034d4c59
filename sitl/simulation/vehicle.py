"""One vehicle as the air process has it: router, autopilot, and a pair of telemetry radios to the ground. No sockets, no clock.

    PHM --- router --- autopilot
               |
          radio on board ~~~ air ~~~ radio on the ground --- ground station

The router passes on what is for all, and what is for someone only to where that one was received, as mavlink-router does.
A radio answers each HEARTBEAT that its own side gives it with a RADIO_STATUS to that side, as SiK firmware does. In that it
reports the other radio, too, until it has received nothing from it for FORGETS_S.
"""

from __future__ import annotations

import random
from collections import Counter
from dataclasses import asdict
from typing import Any, Literal

from phm.simulation.autopilot_model import AUTOPILOT, BOOT_S, AutopilotModel
from phm.simulation.mavlink_port import mavlink
from sitl.simulation.channel_model import Conditions, Pipe
from sitl.simulation.frames import HEARTBEAT, RADIO_STATUS, Frame

Place = Literal["phm", "pilot", "ground"]
PLACES: tuple[Place, ...] = ("phm", "pilot", "ground")
RADIO = (ord("3"), ord("D"))
"""System and component of a SiK radio."""
PHM = 193
PACKETS_S = 20
"""Packets that a SiK pair exchanges each second, also when there is nothing to say: damaged ones are counted in rxerrors."""
FORGETS_S = 3.4
"""SiK firmware looks for packets every 0.524 s and clears the values of the other radio after more than five looks without any: 3.15
to 3.67 s after the last."""
MOST_ROUTES = 64


class _End:
    """One of the two radios."""

    def __init__(self) -> None:
        self._errors, self._since = 0.0, 0.0
        self.partner_at = float("-inf")
        """When the other radio was last received."""
        self._mav = mavlink.MAVLink(None, srcSystem=RADIO[0], srcComponent=RADIO[1])

    def status(self, now: float, air: Conditions, free: int, fixed: int = 0) -> Frame:
        """RADIO_STATUS to its own side."""
        self._errors += air.loss * PACKETS_S * (now - self._since if self._since and not air.cut else 0.0)
        self._since = now
        known = now - self.partner_at <= FORGETS_S
        far_rssi, far_noise = (air.rssi, air.noise) if known else (0, 0)
        message = mavlink.MAVLink_radio_status_message(
            air.rssi, far_rssi, free, air.noise, far_noise, min(int(self._errors), 0xFFFF), fixed
        )
        raw = message.pack(self._mav)
        self._mav.seq = (self._mav.seq + 1) % 256
        return Frame(raw, RADIO_STATUS, *RADIO)


class Vehicle:
    """`take` a frame from a place, advance the time with `tick`, and read the results from `out`: (place, bytes).

    pilot: the simulated autopilot; None: a real one is at the place "pilot".
    """

    def __init__(self, number: int, now: float, chance: random.Random, pilot: AutopilotModel | None) -> None:
        self.number, self.pilot = number, pilot
        self.ground = Conditions()
        self.up: Pipe[Frame] = Pipe(self.ground, chance, filled=True)
        self.down: Pipe[Frame] = Pipe(self.ground, chance)
        self.router_off = self.pilot_off = False
        self.out: list[tuple[Place, bytes]] = []
        self.counts: Counter[str] = Counter()
        self._on_board, self._below = _End(), _End()
        self._routes: dict[tuple[int, int], Place] = {}
        self._now = now

    # ------------------------------------------------------------ input

    def take(self, now: float, place: Place, frame: Frame) -> None:
        """A frame from PHM, from the ground station or from a real autopilot."""
        self.tick(now)
        if place == "ground":
            self._from_station(frame)
        elif place == "phm" or not self.pilot_off:
            self._route(place, frame)
        self.tick(now)

    def tick(self, now: float) -> None:
        """Advance the time: the autopilot's own frames, and arrivals over the radio link."""
        self._now = now
        if not self.ground.cut and not self.ground.off:
            self._on_board.partner_at = self._below.partner_at = now
        if self.pilot is not None:
            self.pilot.booted(now)
            for raw in (*self.pilot.due(now), *self.pilot.due_on(now)):
                self._from_pilot(raw)
        for frame in self.up.arrived(now):
            self.out.append(("ground", frame.raw))
        for frame in self.down.arrived(now):
            if not self.ground.off:
                self._route("ground", frame)

    def next_s(self) -> float | None:
        """When the next event without input may occur."""
        moments = [self.up.next_s(), self.down.next_s(), self.pilot.next_s() if self.pilot is not None else None]
        return min((moment for moment in moments if moment is not None), default=None)

    # ------------------------------------------------------------ changes from outside

    def change(self, link: str, values: dict[str, Any]) -> None:
        """Like `LinkEmulatorClient.set`, for `ground`, `router` and `autopilot`. Raises ValueError for an invalid
        change.
        """
        if link == "ground":
            self.ground.change(values)
            if self.ground.off:
                self.up.clear()
            return
        if set(values) - {"off"} or not isinstance(values.get("off", False), bool):
            raise ValueError(f"of the {link} only `off` can be set, to true or false; asked: {values}")
        if link == "router":
            self.router_off = values.get("off", self.router_off)
            self._routes.clear()
        else:
            self.pilot_off = values.get("off", self.pilot_off)

    def reset(self) -> None:
        """Reset all links, resume the autopilot, and end its reboot."""
        self.ground.change(asdict(Conditions()))
        self.router_off = self.pilot_off = False
        if self.pilot is not None:
            self.pilot.hung = False
            if self.pilot.rebooting:
                self.pilot.reboot(self._now, 0.0)
                self.pilot.booted(self._now)

    def order(self, now: float, what: str, values: dict[str, Any]) -> None:
        """Like `LinkEmulatorClient.autopilot`. Raises ValueError for an invalid command."""
        if self.pilot is None:
            raise ValueError(f"the autopilot of agent {self.number} is a real one: command it by MAVLink")
        if what in ("hang", "resume"):
            self.pilot.hung = what == "hang"
        elif what in ("arm", "disarm"):
            self.pilot.armed = what == "arm"
        elif what == "reboot":
            self.pilot.reboot(now, float(values.get("boot_s", BOOT_S)))
        else:
            raise ValueError(f"an autopilot cannot {what!r}: allowed are hang, resume, reboot, arm, disarm")

    def state(self) -> dict[str, Any]:
        pilot = {}
        if self.pilot is not None:
            pilot = {"armed": self.pilot.armed, "hung": self.pilot.hung, "rebooting": self.pilot.rebooting}
        return {
            "ground": asdict(self.ground),
            "router": {"off": self.router_off},
            "autopilot": {"off": self.pilot_off, **pilot},
        }

    # ------------------------------------------------------------ on board

    def _from_pilot(self, raw: bytes) -> None:
        if not self.pilot_off:
            kind = int.from_bytes(raw[7:10], "little")
            self._route("pilot", Frame(raw, kind, self.number, AUTOPILOT))

    def _route(self, origin: Place, frame: Frame) -> None:
        if self.router_off:
            return
        source = (frame.system, frame.component)
        if source in self._routes or len(self._routes) < MOST_ROUTES:
            self._routes[source] = origin
        for place in self._places(frame):
            if place != origin:
                self._deliver(place, frame)

    def _places(self, frame: Frame) -> tuple[Place, ...]:
        if not frame.target_system:
            return PLACES
        wanted = (frame.target_system, frame.target_component)
        return tuple(
            place
            for place in PLACES
            if any(
                where == place and who[0] == wanted[0] and wanted[1] in (0, who[1])
                for who, where in self._routes.items()
            )
        )

    def _deliver(self, place: Place, frame: Frame) -> None:
        if place == "ground":
            self._into_air(frame)
        elif place == "pilot" and self.pilot is not None:
            if not self.pilot_off and frame.target_system == self.number and frame.target_component in (0, AUTOPILOT):
                for answer in self.pilot.handle(self._now, frame.message):
                    self._from_pilot(answer.frame)
        elif place == "phm" or not self.pilot_off:
            self.out.append((place, frame.raw))

    # ------------------------------------------------------------ radios

    def _into_air(self, frame: Frame) -> None:
        if self.ground.off or frame.kind == RADIO_STATUS:
            return
        size = len(frame.raw)
        if self.up.offer(self._now, size, frame):
            self.counts["to_ground"] += size
            if frame.component == PHM:
                self.counts["phm_to_ground"] += size
        if frame.kind == HEARTBEAT:
            self._route("ground", self._on_board.status(self._now, self.ground, self.up.free_percent(self._now)))

    def _from_station(self, frame: Frame) -> None:
        size = len(frame.raw)
        if self.down.offer(self._now, size, frame):
            self.counts["from_ground"] += size
        if frame.kind == HEARTBEAT:
            free = self.down.free_percent(self._now)
            self.out.append(("ground", self._below.status(self._now, self.ground, free).raw))
