"""Converts the engine's JSON to facts, tolerating missing fields, and finds a container."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from typing import Any

from phm.core.clock import Clock
from phm.core.maintenance import LABEL
from phm.core.settings import ContainerSettings
from phm.facts import (
    Attachment,
    CannotTell,
    ContainerFact,
    DeviceMapping,
    FailedProbe,
    HealthcheckFact,
    Mount,
    OtherContainer,
    ros_variables,
)
from phm.transport.docker import DockerEngine, EngineMissing

ENTRYPOINT = "ros-entrypoint"
"""The first word of the entry point of PHM's image, which starts the program that follows."""
ONEOFF = "com.docker.compose.oneoff"
"""Label of Compose: true at a container of `docker compose run`, which has the labels of its service, too (seen with Compose 2.26)."""
DEPENDS_ON = "com.docker.compose.depends_on"
"""Label of Compose: such as `db:service_healthy:false,cache:service_started:true`, also for `network_mode: service:...`; empty: none."""
_OUTPUT_CHARS = 200
_ALIVE = ("running", "paused", "restarting")
_LEAST_S = 0.05
_MOMENT = re.compile(r"(\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d)(?:\.(\d{1,9}))?")


class TimeBudget:
    """The rest of a method's deadline, for its successive calls."""

    def __init__(self, clock: Clock, limit_s: float) -> None:
        self._clock, self._until = clock, clock.mono() + limit_s

    @property
    def used_up(self) -> bool:
        return self._clock.mono() >= self._until

    def left_s(self) -> float:
        return max(_LEAST_S, self._until - self._clock.mono())


def find(engine: DockerEngine, entry: ContainerSettings, budget: TimeBudget) -> ContainerFact | None:
    """The container that `entry` names, or None. Raises CannotTell if a label matches several."""
    ref = entry.name or _by_label(engine, entry.label or "", budget)
    if not ref:
        return None
    try:
        fact = container_fact(engine.inspect(ref, deadline_s=budget.left_s()))
    except EngineMissing:
        return None
    # The engine also accepts the beginning of an id as a name.
    return None if entry.name and fact.name != entry.name else fact


def _by_label(engine: DockerEngine, label: str, budget: TimeBudget) -> str:
    """Id of the container with that label, or empty. A running one has priority over stopped ones that it replaced."""
    found = [
        entry
        for entry in engine.list(label=label, deadline_s=budget.left_s())
        if entry.get("State") not in ("removing", "dead") and has_label(label, _part(entry, "Labels"))
    ]
    if len(found) > 1:
        found = [entry for entry in found if entry.get("State") in _ALIVE] or found
    if len(found) > 1:
        names = ", ".join(sorted(_name(entry) for entry in found))
        raise CannotTell(f"the label {label} names {len(found)} containers ({names}): use a label that only one has")
    return str(found[0].get("Id", "")) if found else ""


def _name(summary: Mapping[str, Any]) -> str:
    return str((summary.get("Names") or [summary.get("Id", "?")])[0]).lstrip("/")


def is_configured(entry: ContainerSettings, summary: Mapping[str, Any]) -> bool:
    """Whether a container of the engine's list is the configured one."""
    if entry.name:
        return f"/{entry.name}" in _texts(summary, "Names")
    return has_label(entry.label or "", _part(summary, "Labels"))


def has_label(label: str, labels: Mapping[str, Any]) -> bool:
    """Whether a container with these labels is one that `label` (`NAME` or `NAME=VALUE`) names.

    A container of `docker compose run` is not its service's container, unless it is what `label` is about.
    """
    name, has_value, value = label.partition("=")
    if name not in labels or (has_value and _text(labels[name]) != value):
        return False
    return name == ONEOFF or _text(labels.get(ONEOFF)).lower() != "true"


def summary_of(answer: Mapping[str, Any]) -> Mapping[str, Any]:
    """The part of an inspect response that `is_configured` compares, as the engine lists it."""
    return {"Names": [_text(answer.get("Name"))], "Labels": _part(_part(answer, "Config"), "Labels")}


def other_container(summary: Mapping[str, Any]) -> OtherContainer:
    return OtherContainer(_name(summary), _text(summary.get("Image"))[:_OUTPUT_CHARS])


def is_phm(answer: Mapping[str, Any]) -> bool:
    """Whether an inspect response describes a container that runs PHM: its program is the entry point, as in PHM's image, or a shell
    starts the daemon beside its page (docker/compose.yaml, BlueOS)."""
    config = _part(answer, "Config")
    words = _texts(config, "Entrypoint")
    beside = words == (ENTRYPOINT,) and any("phm run" in word for word in _texts(config, "Cmd"))
    return beside or any(word.rpartition("/")[2] == "phm" for word in words)


def container_fact(answer: Mapping[str, Any]) -> ContainerFact:
    """The fact from an inspect response. Raises CannotTell if it contains no container or no state."""
    state, host = _part(answer, "State"), _part(answer, "HostConfig")
    health, labels = _part(state, "Health"), _part(_part(answer, "Config"), "Labels")
    if not answer.get("Id") or not state.get("Status"):
        raise CannotTell("the Docker Engine described a container without id or state")
    return ContainerFact(
        name=_text(answer.get("Name")).lstrip("/"),
        id=_text(answer.get("Id")),
        status=_text(state.get("Status")),
        started_at=_text(state.get("StartedAt")),
        created_at=_utc(answer.get("Created")),
        exit_code=_number(state.get("ExitCode")),
        oom_killed=bool(state.get("OOMKilled")),
        error=_text(state.get("Error")),
        pid=_number(state.get("Pid")),
        health=_text(health.get("Status")) or "none",
        health_streak=_number(health.get("FailingStreak")),
        health_output=_output(health),
        failed_probes=_failed_probes(health),
        passed_probes_s=_passed_probes_s(health),
        probe_ended=_probe_ended(health),
        healthcheck=_healthcheck(_part(_part(answer, "Config"), "Healthcheck")),
        restart_count=_number(answer.get("RestartCount")),
        restart_policy=_text(_part(host, "RestartPolicy").get("Name")) or "no",
        network_mode=_text(host.get("NetworkMode")) or "default",
        pid_mode=_text(host.get("PidMode")),
        ipc_mode=_text(host.get("IpcMode")),
        ros_variables=ros_variables(_environment(_texts(_part(answer, "Config"), "Env"))),
        networks=_networks(_part(_part(answer, "NetworkSettings"), "Networks")),
        mounts=_mounts(_several(answer, "Mounts"), host),
        devices=tuple(
            DeviceMapping(
                host_path=_text(device.get("PathOnHost")),
                container_path=_text(device.get("PathInContainer")),
                permissions=_text(device.get("CgroupPermissions")) or "rwm",
            )
            for device in _several(host, "Devices")
        ),
        device_rules=_texts(host, "DeviceCgroupRules"),
        privileged=bool(host.get("Privileged")),
        stop_signal=_signal(_part(answer, "Config").get("StopSignal")),
        stop_timeout_s=_seconds(_part(answer, "Config").get("StopTimeout")),
        cgroup_parent=_text(host.get("CgroupParent")),
        cpu_limit=_cpu_limit(host),
        cpu_period_s=_cpu_period_s(host),
        memory_limit=_memory_limit(host),
        depends_on=_text(labels[DEPENDS_ON])[:_OUTPUT_CHARS] if DEPENDS_ON in labels else None,
        maintenance=_text(labels.get(LABEL))[:_OUTPUT_CHARS],
    )


def _environment(lines: Sequence[str]) -> dict[str, str]:
    """Variables by name, from lines of the form NAME=VALUE."""
    pairs = (line.partition("=") for line in lines)
    return {name: value for name, equals, value in pairs if equals}


def _cpu_limit(host: Mapping[str, Any]) -> float | None:
    """CPU limit in CPUs, from `--cpus` or `--cpu-quota`."""
    cpus = _number(host.get("NanoCpus")) / 1e9 or _number(host.get("CpuQuota")) / 1e6 / _cpu_period_s(host)
    return cpus if cpus > 0 else None


def _cpu_period_s(host: Mapping[str, Any]) -> float:
    period_us = _number(host.get("CpuPeriod"))
    return period_us / 1e6 if period_us > 0 else 0.1


def _memory_limit(host: Mapping[str, Any]) -> int | None:
    """Bytes, from `--memory`."""
    limit = _number(host.get("Memory"))
    return limit if limit > 0 else None


def _signal(value: Any) -> int:
    """The number of a signal in Docker's notation: a number, or a name with or without SIG, also `SIGRTMIN+3`."""
    name, plus, more = _text(value).upper().partition("+")
    if name.isdecimal():
        return int(name)
    try:
        number = signal.Signals[name if name.startswith("SIG") else f"SIG{name}"].value
    except KeyError:
        return int(signal.SIGTERM)
    return number + int(more) if plus and more.isdecimal() else number


def _seconds(value: Any) -> float | None:
    return float(value) if isinstance(value, int) else None


def _healthcheck(given: Mapping[str, Any]) -> HealthcheckFact | None:
    """Times are in nanoseconds; 0 or a missing value means the engine's default."""
    test = given.get("Test") or []
    if not test or test == ["NONE"]:
        return None
    default = HealthcheckFact()

    def seconds(key: str, otherwise_s: float) -> float:
        return _number(given.get(key)) / 1e9 or otherwise_s

    return HealthcheckFact(
        seconds("Interval", default.interval_s),
        seconds("Timeout", default.timeout_s),
        seconds("StartPeriod", default.start_period_s),
        seconds("StartInterval", default.start_interval_s),
        _number(given.get("Retries")) or default.retries,
    )


def _networks(networks: Mapping[str, Any]) -> tuple[Attachment, ...]:
    found = []
    for name in networks:
        attached = _part(networks, name)
        fixed = _part(attached, "IPAMConfig")
        found.append(
            Attachment(
                name=name,
                network_id=_text(attached.get("NetworkID")),
                address=_text(attached.get("IPAddress")) or _text(attached.get("GlobalIPv6Address")),
                gateway=_text(attached.get("Gateway")),
                aliases=_texts(attached, "Aliases"),
                fixed_addresses=tuple(_text(fixed[key]) for key in ("IPv4Address", "IPv6Address") if fixed.get(key)),
            )
        )
    return tuple(found)


def _mounts(mounts: Sequence[Mapping[str, Any]], host: Mapping[str, Any]) -> tuple[Mount, ...]:
    """Mounts, including `--tmpfs`, which the engine lists separately, as it does the subpath of a volume."""
    subpaths = {
        os.path.normpath(_text(asked.get("Target"))): _text(_part(asked, "VolumeOptions").get("Subpath"))
        for asked in _several(host, "Mounts")
    }
    found = [
        Mount(
            kind=_text(mount.get("Type")),
            source=_text(mount.get("Source")),
            destination=_text(mount.get("Destination")),
            name=_text(mount.get("Name")),
            writable=bool(mount.get("RW", True)),
            subpath=subpaths.get(_text(mount.get("Destination")), ""),
        )
        for mount in mounts
    ]
    return (*found, *(Mount(kind="tmpfs", source="", destination=path) for path in _part(host, "Tmpfs")))


def _output(health: Mapping[str, Any]) -> str:
    """What the health command printed last, on one line."""
    log = _several(health, "Log")
    return " ".join(_text(log[-1].get("Output")).split())[:_OUTPUT_CHARS] if log else ""


def _failed_probes(health: Mapping[str, Any]) -> tuple[FailedProbe, ...]:
    """The failed runs at the end of the engine's log."""
    found: list[FailedProbe] = []
    for entry in reversed(_several(health, "Log")):
        if _number(entry.get("ExitCode")) == 0:
            break
        found.append(FailedProbe(_number(entry.get("ExitCode")), _took_s(entry)))
    return tuple(reversed(found))


def _passed_probes_s(health: Mapping[str, Any]) -> tuple[float, ...]:
    passed = (_took_s(entry) for entry in _several(health, "Log") if _number(entry.get("ExitCode")) == 0)
    return tuple(took_s for took_s in passed if took_s is not None)


def _probe_ended(health: Mapping[str, Any]) -> str:
    log = _several(health, "Log")
    return _text(log[-1].get("End")) if log else ""


def _took_s(entry: Mapping[str, Any]) -> float | None:
    begun, ended = _moment(entry.get("Start")), _moment(entry.get("End"))
    return None if begun is None or ended is None else max(0.0, (ended - begun).total_seconds())


def _moment(value: Any) -> datetime | None:
    """The engine's time stamp, to a microsecond: it has up to nine decimals, and its zone is the same in one log."""
    found = _MOMENT.match(_text(value))
    if found is None:
        return None
    try:
        seconds = datetime.fromisoformat(found[1])
    except ValueError:
        return None
    return seconds.replace(microsecond=int((found[2] or "0")[:6].ljust(6, "0")))


def _utc(value: Any) -> float | None:
    """The same in seconds since the epoch; None: not in UTC."""
    moment = _moment(value) if _text(value).endswith("Z") else None
    return moment.replace(tzinfo=timezone.utc).timestamp() if moment is not None else None


def _part(answer: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    part = answer.get(key)
    return part if isinstance(part, Mapping) else {}


def _several(answer: Mapping[str, Any], key: str) -> Sequence[Mapping[str, Any]]:
    found = answer.get(key)
    return [entry for entry in found if isinstance(entry, Mapping)] if isinstance(found, list) else []


def _texts(answer: Mapping[str, Any], key: str) -> tuple[str, ...]:
    found = answer.get(key)
    return tuple(_text(value) for value in found) if isinstance(found, list) else ()


def _text(value: Any) -> str:
    return "" if value is None else str(value)


def _number(value: Any) -> int:
    return value if isinstance(value, int) else 0
