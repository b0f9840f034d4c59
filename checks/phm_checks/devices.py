"""Slot 5: the application's devices exist, can be opened, and are mapped into its container."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from phm import api
from phm.api import Slot
from phm_checks._per_container import PerContainer
from phm_checks._text import brief, clean, joined, last, listed, merged

_SERIAL_MAJORS = frozenset({166, 188, 204})
"""ttyACM, ttyUSB and the UARTs of ARM boards, from the kernel's devices.txt; ttyS is 4 from minor 64 on."""
_SERIAL_NAME = re.compile(r"/dev/(tty[A-Za-z]|rfcomm)[^/]*")
"""Other drivers, such as ttyTHS of a Jetson, get a number when they are loaded."""
SETTLE_S = 0.1
"""udev rules may recreate a device file and its links within a moment; the check runs on each change of the folder."""
_RULE = re.compile(r"^([acb])\s+(\d+|\*):(\d+|\*)(?:\s+[rwm]+)?$")


def is_serial(fact: api.DeviceFact) -> bool:
    """Whether opening it could raise a modem line and so reset the hardware behind it."""
    numbered = fact.major in _SERIAL_MAJORS or (fact.major == 4 and fact.minor >= 64)
    return numbered or _SERIAL_NAME.fullmatch(fact.path) is not None or bool(fact.description)


@dataclass(slots=True)
class _Known:
    """A device as first seen since the container started; `away` once it was missing or replaced."""

    generation: str
    numbers: tuple[int, int] | None
    """Major and minor; None if it was missing."""
    inode: int
    away: bool = False
    seen_start: bool = False
    """The container was started in this run of PHM: no change since then is unknown."""


class Devices(PerContainer):
    """All configured devices of one container.

    The unit does not depend on a running container: Docker refuses to start a container whose device is missing, and
    then the device is the cause.
    """

    name, slot = "devices", Slot.DEVICES
    period_s = 5.0
    """Changes of a device file wake the check; the period is for problems that only opening the device shows."""

    def __init__(self, entry: api.ContainerSettings) -> None:
        super().__init__(entry)
        self._known: dict[str, _Known] = {}

    @classmethod
    def wanted(cls, entry: api.ContainerSettings) -> bool:
        return bool(entry.devices)

    @property
    def units(self) -> Sequence[api.Unit]:
        return (api.Unit(self.unit_id, target=self.key, settle_s=SETTLE_S),)

    @property
    def wakes(self) -> frozenset[str]:
        return super().wakes | {"device"}

    def run(self, world: api.World) -> api.Result:
        container, why = self._container(world)
        findings = [self._judge(world, wanted, container, why) for wanted in self.entry.devices]
        first = api.worst(findings)
        values: dict[str, api.Value] = {
            "devices": len(findings),
            "devices_bad": sum(finding.level.bad for finding in findings),
        }
        if first.level is api.Level.OK:
            said = joined([finding.summary for finding in findings])
            count = "1 device" if len(findings) == 1 else f"{len(findings)} devices"
            unknown = tuple(name for finding in findings for name in finding.evidence.unobserved_of)
            found = api.ok(f"Found {count} in container {self.key}: {said}", values=values)
            return found.with_evidence(api.Evidence(unobserved_of=unknown))
        lost = tuple(name for finding in findings for name in finding.evidence.subjects or ())
        return merged(findings, values).with_evidence(api.Evidence(subjects=lost or None))

    def _container(self, world: api.World) -> tuple[api.ContainerFact | None, str]:
        """The container, or None and why its mapping cannot be checked."""
        try:
            return world.docker.container(self.key), f"container {self.key} does not exist"
        except api.CannotTell as reason:
            return None, clean(str(reason))

    def _judge(
        self, world: api.World, wanted: api.DeviceSettings, container: api.ContainerFact | None, why: str
    ) -> api.Result:
        path = wanted.path
        try:
            fact = world.devices.inspect(path, open_it=wanted.open == "always")
            if fact is not None and wanted.open == "auto" and fact.character and not is_serial(fact):
                fact = world.devices.inspect(path, open_it=True)
        except api.CannotTell as reason:
            return api.stale(f"device {path} cannot be checked: {clean(str(reason))}")
        if container is not None:
            self._remember(path, fact, container)
        if fact is None:
            return self._missing(world, path)
        if not fact.character:
            advice = "list character devices only" if fact.block else "correct the path, or remove what is in its place"
            words = f"{path} is not a character device{_because(fact.reason)}: {advice}"
            return self._bad(path, words, "not a device", "device_wrong_type")
        if fact.openable is False:
            words = (
                f"{path} exists but cannot be used{_because(fact.reason)}: check its driver, cable and access rights"
            )
            return self._bad(path, words, "cannot be opened", "device_refused")
        found = f"{path} exists{_because(fact.description)}"
        if not wanted.mapped:
            return api.ok(found)
        if container is None:
            return api.stale(f"{found}, but whether {self.key} sees it is unknown: {why}")
        return self._mapping(world, wanted, fact, container, found)

    def _missing(self, world: api.World, path: str) -> api.Result:
        try:
            ports = listed(f"{port.path}{_because(port.description)}" for port in world.devices.serial_ports())
        except api.CannotTell:
            ports = "not known"
        words = f"device {path} is missing: check its cable and power. Serial ports present: {ports}"
        return self._bad(path, words, "missing", "device_missing")

    def _mapping(
        self,
        world: api.World,
        wanted: api.DeviceSettings,
        fact: api.DeviceFact,
        container: api.ContainerFact,
        found: str,
    ) -> api.Result:
        problem = ""
        mapped = [one for one in container.devices if self._maps(world, one, wanted.path, fact)]
        inside = wanted.in_container
        if mapped:
            names = [one.container_path for one in mapped]
            if inside is not None and inside not in names:
                problem = f"it appears there as {listed(names)}, expected {inside}"
        elif not container.privileged:
            problem = self._through_mount(world, wanted, fact, container)
        # A stopped container gets a new copy of the device file at its start.
        used = inside or (_shown(mapped[0], wanted.path) if mapped else wanted.path)
        running = container.status in ("running", "paused")
        copied = running and not _follows_host(wanted.path, used, container)
        copy = (f"{wanted.path} in the run since {container.started_at}",)
        known = self._known[wanted.path]
        if not problem and copied and known.numbers != _numbers(fact):
            words = (
                f"{wanted.path} was disconnected and is back, but {self.key} still has the old device file from its start: "
                f"restart {self.key} so that it can use the device again"
            )
            lost = self._bad(wanted.path, words, "replugged, not usable", "device_replugged")
            return lost.with_evidence(api.Evidence(subjects=copy))
        if not problem:
            # A PHM that was restarted does not know whether it was replaced before.
            evidence = api.Evidence(unobserved_of=copy if copied and not known.seen_start else ())
            words = f"{found}, mapped into {self.key}"
            if running and known.away:
                words += f". It was disconnected after {self.key} started: a program that has not reopened it needs a restart"
            return api.ok(words).with_evidence(evidence)
        words = f"{wanted.path} exists, but {self.key} cannot use it: {problem}"
        return self._bad(wanted.path, words, "not in container", "device_unmapped")

    @staticmethod
    def _maps(world: api.World, mapping: api.DeviceMapping, path: str, fact: api.DeviceFact) -> bool:
        """Whether this entry brings the device: by its path, by a folder above it, or by another name of it."""
        host = mapping.host_path.rstrip("/")
        if host in (path, fact.path) or path.startswith(f"{host}/") or fact.path.startswith(f"{host}/"):
            return True
        try:
            other = world.devices.inspect(host, open_it=False) if host.startswith("/dev/") else None
        except api.CannotTell:
            return False
        return other is not None and other.character and (other.major, other.minor) == (fact.major, fact.minor)

    def _remember(self, path: str, fact: api.DeviceFact | None, container: api.ContainerFact) -> None:
        """Track changes of a device. Docker copies its file when the container starts, and allows it by its numbers: one that is
        back with other numbers needs a restart of the container, one with the same numbers only has to be opened again."""
        numbers, inode = _numbers(fact), fact.inode if fact is not None else 0
        known = self._known.get(path)
        if known is None or known.generation != container.generation:
            self._known[path] = _Known(container.generation, numbers, inode, seen_start=known is not None)
        elif numbers is None or (numbers, inode) != (known.numbers, known.inode):
            known.away = True

    def _through_mount(
        self, world: api.World, wanted: api.DeviceSettings, fact: api.DeviceFact, container: api.ContainerFact
    ) -> str:
        """Empty when a bind mount and a device cgroup rule provide the device; else what is missing."""
        path, inside = wanted.path, wanted.in_container or wanted.path
        binds = [
            (one.source.rstrip("/"), one.destination.rstrip("/")) for one in container.mounts if one.kind == "bind"
        ]
        shown = [here + path[len(source) :] for source, here in binds if f"{path}/".startswith(f"{source}/")]
        # A link beside it, e.g. of udev, may be what the application opens.
        hosts = [source + inside[len(here) :] for source, here in binds if f"{inside}/".startswith(f"{here}/")]
        bound = any(self._maps(world, api.DeviceMapping(host, inside), path, fact) for host in hosts)
        allowed = any(_allows(rule, fact) for rule in container.device_rules)
        if bound and allowed:
            return ""
        rule = f"device_cgroup_rules: ['c {fact.major}:* rmw']"
        if bound:
            return f"it is bind-mounted, but no device cgroup rule allows opening it; add {rule}"
        if shown:
            missing = "" if allowed else f", and add {rule}"
            return (
                f"it appears there as {listed(shown)}, expected {inside}; change the mount or `in_container`{missing}"
            )
        if allowed:
            return "a device cgroup rule allows it, but the device file is not mounted; bind-mount /dev"
        return f"it is not among its devices; add `devices: ['{path}']`"

    def _bad(self, path: str, words: str, short: str, condition: str) -> api.Result:
        return api.error(words, brief=brief(last(path), short), condition=condition, target=self.key)


def _numbers(fact: api.DeviceFact | None) -> tuple[int, int] | None:
    """What a program in the container opens: the name and the inode of a device file play no role."""
    return (fact.major, fact.minor) if fact is not None and fact.character else None


def _shown(mapping: api.DeviceMapping, path: str) -> str:
    """The path of a device inside the container. A mapped folder has it by its own name."""
    host = mapping.host_path.rstrip("/")
    return mapping.container_path + path[len(host) :] if path.startswith(f"{host}/") else mapping.container_path


def _follows_host(path: str, inside: str, container: api.ContainerFact) -> bool:
    """Whether a bind-mounted folder such as /dev shows the device where the container uses it, so that it sees the host's
    changes. Elsewhere, as with / at /host, the device file that it uses is still that of its start."""
    folders = ((one.source.rstrip("/"), one.destination.rstrip("/")) for one in container.mounts if one.kind == "bind")
    return any(path.startswith(f"{source}/") and inside == here + path[len(source) :] for source, here in folders)


def _because(text: str) -> str:
    return f" ({clean(text, 120)})" if text else ""


def _allows(rule: str, fact: api.DeviceFact) -> bool:
    """Whether a device cgroup rule such as ``c 188:* rmw`` allows reading the device."""
    match = _RULE.match(rule.strip())
    if match is None or (" " in rule.strip() and not set(rule.split()[-1]) & set("r")):
        return False
    kind, major, minor = match.groups()
    return kind in "ca" and major in ("*", str(fact.major)) and minor in ("*", str(fact.minor))
