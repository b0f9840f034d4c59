"""Slot 1: each MAVLink endpoint is open and its data are intact. A closed serial port is reported with the reason."""

from __future__ import annotations

import errno
from collections.abc import Iterable, Sequence
from dataclasses import replace

from phm import api
from phm.api import Layer, Slot
from phm_checks._command_path import (
    kind,
    link_id,
    link_of,
    named,
    reboots_on_command,
    routed,
    starting,
    target_of,
    ways,
)
from phm_checks._text import StableNumber, brief, clean, last, listed, merged, span

SETTLE_S = 2.0
"""A port or connection that reopens within this time is not reported: a USB autopilot disappears briefly when it reboots."""
REFUSALS, STEADY_S = 2, 5.0
"""After this many refused attempts in a row (0.3 s) nothing listens any more. Reported without settle time if the endpoint
had been open for STEADY_S."""
GRACE_S = 5.0
SILENT_S = 3.0
"""A router with several recent senders forwards at least their heartbeats, one per second each."""
TOGETHER_S = 3.0
UNDECODABLE_S = 20.0
"""Bytes per second without valid frames: the data are not MAVLink at this baud rate."""
VALID_SHARE = 0.5
"""Where PHM can compute no checksum, frames must be at least this part of the bytes, and more than the false starts: any bytes
contain a few frames by chance."""
LINE_ERRORS_S = 1.0
EASE = 0.7
MOST_SENDERS = 8
_IN_USE = frozenset((errno.EAGAIN, errno.EBUSY))
_REFUSED = frozenset((errno.EACCES, errno.EPERM))
_NO_DEVICE = frozenset((errno.ENXIO, errno.ENODEV))
_WORKS = frozenset({"line_errors", "frames_lost"})
"""Conditions of a link that is open and on which frames are received: no earlier failure lasts."""


class Link(api.Check):
    """One MAVLink endpoint of the configuration."""

    name, slot, layer = "link", Slot.COMPANION, Layer.LINK
    period_s = 1.0

    def __init__(self, entry: api.EndpointSettings, settings: api.Settings) -> None:
        self.entry, self._settings = entry, settings
        self._label = named(kind(entry), entry, ways(settings))
        self._loss, self._silence = StableNumber(share=0.5), StableNumber(share=1.0)
        self._was: frozenset[str] = frozenset()
        self._open_since: float | None = float("-inf")
        """None while it is closed."""
        self._opened = self._steady = False
        """Whether it has ever been open, and whether the last time lasted STEADY_S."""
        self._device_unit = _devices_of(entry, settings)

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [cls(entry, settings) for entry in settings.mavlink.endpoints]

    @property
    def subject(self) -> str:
        return api.topic_id(self.entry.key)

    @property
    def units(self) -> Sequence[api.Unit]:
        target = target_of(self.entry.key)
        needs = (f"container/{self.entry.container}",) if self.entry.container else ()
        return (api.Unit(link_id(self.entry), needs=needs, target=target, settle_s=SETTLE_S, grace_s=GRACE_S),)

    @property
    def wakes(self) -> frozenset[str]:
        return frozenset({"link"})

    def run(self, world: api.World) -> api.Result:
        link = link_of(world, self.entry.key)
        if link is None:
            return api.stale(f"the MAVLink endpoint {self.entry.key} has not been tried yet")
        if not link.open:
            if self._open_since is not None:
                self._steady = self._opened and world.clock.mono() - self._open_since >= STEADY_S
            self._open_since = None
            return self._closed(world, link) if self._opened or not starting(world) else _not_yet(link)
        self._opened = True
        self._open_since = world.clock.mono() if self._open_since is None else self._open_since
        findings = [*self._silent(world, link), *self._undecodable(link), *self._line(link), *self._lossy(world, link)]
        self._was = frozenset(finding.condition for finding in findings)
        values = _values(link)
        if not findings:
            self._loss.forget("loss")
            self._silence.forget("silence")
            return api.ok(f"MAVLink endpoint {clean(link.name, 80)} is open{_traffic(link)}", values=values)
        return merged(findings, values).with_evidence(api.Evidence(recovered=self._was <= _WORKS))

    # ------------------------------------------------------------ closed

    def _closed(self, world: api.World, link: api.LinkFact) -> api.Result:
        """ERROR; WARN while another endpoint reaches the same peers, so that only redundancy is lost, and while the autopilot
        reboots on command."""
        missing = self.entry.serial and not self._there(world, link)
        if missing and self._device_unit:
            # Not as a dependency: a fault of another device of that container would then hide faults of this link.
            return api.stale(f"the port {self.entry.url} is missing, which {self._device_unit} reports")
        if missing:
            why = f"the port {self.entry.url} is missing: check its cable and power. Ports present: {_ports(world)}"
            short = f"{last(self.entry.url)} missing"
        else:
            why, short = self._port(world, link) if self.entry.serial else self._connection(link)
        spare = self._spare(world)
        more = "; its peers are reachable through another endpoint meanwhile" if spare else ""
        rebooting = self.entry.to_autopilot and reboots_on_command(world.links.autopilot())
        more += "; the autopilot has acknowledged a command to reboot" if rebooting else ""
        make = api.warn if spare or rebooting else api.error
        found = make(
            f"MAVLink endpoint {clean(link.name, 80)} is closed: {why}{more}. PHM reopens it as soon as possible",
            brief=brief(f"{self._label}:", short),
            condition="link_closed",
        )
        refused = link.code == errno.ECONNREFUSED and link.failed >= REFUSALS
        return replace(found, settle_s=0.0) if refused and self._steady else found

    def _there(self, world: api.World, link: api.LinkFact) -> bool:
        try:
            return world.devices.inspect(self.entry.url, open_it=False) is not None
        except api.CannotTell:
            return link.code != errno.ENOENT

    def _port(self, world: api.World, link: api.LinkFact) -> tuple[str, str]:
        """Why an existing serial port is closed (permission, another user, failure), and the same in a few words."""
        path, said, name = self.entry.url, clean(link.error) or "no reason given", last(self.entry.url)
        if link.code == errno.ENOENT:
            return (
                f"the port {path} exists on the host but not in PHM's container: add it to `devices` of PHM's service",
                f"{name} not in PHM container",
            )
        if link.code in _REFUSED:
            return (
                f"PHM has no permission to open the port {path} ({said}): give PHM's container the device (`devices` or "
                "`device_cgroup_rules`) and its group (`group_add: [dialout]`)",
                f"{name} no permission",
            )
        if link.code in _IN_USE:
            who = _users(world, path)
            by = f" by {who[0].partition(' (')[0]}" if who else ""
            whose = listed(who) if who else "a program that PHM cannot see from its container"
            return (
                f"the port {path} is in use by {whose}: two programs on one port take each other's bytes; stop one, or share "
                "the port through a MAVLink router",
                f"{name} in use{by}",
            )
        # Docker makes a container's device files at its start: on USB, the device may have another number since.
        old = "; or PHM's container has the old device file: `docker compose up -d --force-recreate phm`"
        more = old if link.code in _NO_DEVICE else ""
        return f"the port {path} exists but cannot be used ({said}): check its cable and driver{more}", f"{name} failed"

    def _connection(self, link: api.LinkFact) -> tuple[str, str]:
        said = clean(link.error) or "no reason given"
        if said.startswith("the name host.docker.internal "):  # as phm.transport.dns begins
            line = '`extra_hosts: ["host.docker.internal:host-gateway"]`'
            return f"{said}: add {line} to PHM's service, or with host networking use 127.0.0.1", clean(said, 24)
        what = "the router" if self.entry.leads_to == "router" else "the other side"
        if link.code == errno.ECONNREFUSED:
            return f"nothing listens at {self.entry.url} ({said}): check that {what} runs", "refused"
        return f"{said} ({self.entry.url}): check the network, the address, and that {what} runs", clean(said, 24)

    def _spare(self, world: api.World) -> bool:
        """Whether other endpoints receive from the ground and the autopilot, as far as this endpoint leads there."""
        if not (self.entry.to_ground or self.entry.to_autopilot):
            return False
        gcs, pilot, limits = world.links.gcs(), world.links.autopilot(), self._settings.mavlink
        ground = gcs is not None and gcs.silent_s <= limits.gcs_timeout and gcs.link not in ("", self.entry.key)
        if self.entry.to_ground and not ground:
            return False
        expected = pilot is not None or limits.autopilot or self.entry.leads_to == "autopilot"
        if not self.entry.to_autopilot or not expected:
            return True
        flying = pilot is not None and pilot.silent_s <= limits.autopilot_timeout
        return flying and pilot is not None and pilot.link not in ("", self.entry.key)

    # ------------------------------------------------------------ open

    def _silent(self, world: api.World, link: api.LinkFact) -> list[api.Result]:
        """When all of several senders behind a router stop together, the router has stopped."""
        silent_s = link.rx_age_s
        if silent_s is None or silent_s < SILENT_S or not routed(world, self.entry) or self._just_opened(world):
            return []
        together = [sender for sender in link.senders if sender.age_s <= silent_s + TOGETHER_S]
        if len(together) < 2:
            return []
        names = listed(f"{sender.system}/{sender.component}" for sender in together)
        return [
            api.error(
                f"nothing received from the router at {self.entry.url} for {span(silent_s)}, though {len(together)} senders "
                f"were active there until then ({names}): check that it runs",
                brief=brief(f"{self._label}:", f"silent {self._silence.show('silence', silent_s):.0f} s"),
                condition="link_silent",
                target=target_of(self.entry.key),
            )
        ]

    def _just_opened(self, world: api.World) -> bool:
        """Whether senders had no time yet to be received; reopening the endpoint would only prolong that."""
        return self._open_since is not None and world.clock.mono() - self._open_since < SILENT_S

    def _undecodable(self, link: api.LinkFact) -> list[api.Result]:
        if link.rx_s is None or link.rx_s < UNDECODABLE_S or _decodable(link, link.rx_s):
            return []
        hint = f"its speed ({self.entry.baud} baud) and wiring" if self.entry.serial else "which program sends there"
        return [
            api.error(
                f"{link.rx_s:.0f} bytes a second arrive on {self.entry.key}, but none are valid MAVLink: check {hint}",
                brief=brief(f"{self._label}:", "no valid MAVLink"),
                condition="link_undecodable",
            )
        ]

    def _line(self, link: api.LinkFact) -> list[api.Result]:
        if link.line is None:
            return []
        limit = LINE_ERRORS_S * (EASE if "line_errors" in self._was else 1.0)
        damaged_s, lost_s = link.line.framing_s + link.line.parity_s, link.line.overrun_s
        found = []
        if damaged_s > limit:
            words = f"{damaged_s:.1f} framing errors a second on {self.entry.url}: check its speed, cable and ground"
            found.append(api.warn(words, brief=brief(f"{self._label}:", "framing errors"), condition="line_errors"))
        if lost_s > limit:
            words = (
                f"{lost_s:.1f} overruns a second on {self.entry.url}: bytes arrive faster than they are read; lower its speed, "
                "or check what keeps the CPU busy"
            )
            found.append(api.warn(words, brief=brief(f"{self._label}:", "overruns"), condition="line_errors"))
        return found

    def _lossy(self, world: api.World, link: api.LinkFact) -> list[api.Result]:
        """Frame loss of the direct neighbour on a serial port. Other senders are not evaluated: routers and autopilots
        filter frames, which leaves gaps in their sequence numbers too."""
        neighbour = self._neighbour(world)
        sender = next((one for one in link.senders if (one.system, one.component) == neighbour), None)
        loss = sender.loss_percent if sender is not None else None
        limit = self._settings.mavlink.loss * (EASE if "frames_lost" in self._was else 1.0)
        if not self.entry.serial or loss is None or loss <= limit:
            return []
        return [
            api.warn(
                f"{loss:.0f} % of the frames from {neighbour[0]}/{neighbour[1]} by {self.entry.url} are lost, expected "
                f"{self._settings.mavlink.loss:g} % or less: check its cable, speed and, with a radio, the distance",
                brief=brief(f"{self._label}:", f"{self._loss.show('loss', loss):.0f}% frames lost"),
                condition="frames_lost",
            )
        ]

    def _neighbour(self, world: api.World) -> tuple[int, int]:
        if self.entry.to_autopilot:
            return self._settings.agent.id, 1
        gcs = world.links.gcs()
        return (gcs.system, gcs.component) if gcs is not None else (0, 0)


def _decodable(link: api.LinkFact, rx_s: float) -> bool:
    """Whether MAVLink is received; a link may carry only messages whose definition PHM does not have."""
    if link.verified_s or not link.frames_s:
        return bool(link.frames_s)
    enough = link.frame_bytes_s is None or link.frame_bytes_s >= VALID_SHARE * rx_s
    return enough and (link.bad_s is None or link.bad_s < link.frames_s)


def _devices_of(entry: api.EndpointSettings, settings: api.Settings) -> str:
    """The unit that reports a missing port because the port is also a configured device; empty for none."""
    check = settings.checks.get("devices")
    if check is not None and not check.enabled:
        return ""
    users = (one.key for one in settings.containers if any(device.path == entry.url for device in one.devices))
    return next((f"devices/{key}" for key in users), "")


def _not_yet(link: api.LinkFact) -> api.Result:
    return api.stale(
        f"MAVLink endpoint {clean(link.name, 80)} could not be opened yet ({clean(link.error) or 'no reason'})"
    )


def _ports(world: api.World) -> str:
    try:
        return listed(port.path for port in world.devices.serial_ports())
    except api.CannotTell:
        return "not known"


def _users(world: api.World, path: str) -> Sequence[str]:
    try:
        return world.links.users(path)
    except api.CannotTell:
        return ()


def _traffic(link: api.LinkFact) -> str:
    if link.rx_s is None or link.tx_s is None:
        return ""
    return f": {link.rx_s:.0f} bytes a second in, {link.tx_s:.0f} out, {len(link.senders)} senders"


def _values(link: api.LinkFact) -> dict[str, api.Value]:
    rounded = {
        "rx_age_s": link.rx_age_s,
        "rx_bytes_s": link.rx_s,
        "tx_bytes_s": link.tx_s,
        "frames_s": link.frames_s,
        "bad_s": link.bad_s,
        "framing_s": None if link.line is None else link.line.framing_s,
        "overrun_s": None if link.line is None else link.line.overrun_s,
    }
    busiest = sorted(link.senders, key=lambda sender: -sender.frames)[:MOST_SENDERS]
    loss = {f"loss_{one.system}_{one.component}_percent": one.loss_percent for one in busiest}
    return {
        "senders": len(link.senders),
        **{name: None if value is None else round(value, 1) for name, value in {**rounded, **loss}.items()},
    }
