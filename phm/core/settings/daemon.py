"""Sections of the daemon itself: `log`, `docker`, `process` and `checks`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema

from phm.core.settings.base import AbsolutePath, Bytes, Name, Seconds, Section, UnexpectedLevel


def _sync(value: Any) -> Any:
    """`true` and `false` are the values of earlier versions."""
    return {True: "always", False: "never"}[value] if isinstance(value, bool) else value


Sync = Annotated[
    Literal["auto", "always", "never"],
    BeforeValidator(_sync),
    WithJsonSchema({"enum": ["auto", "always", "never", True, False]}),
]


class LogSettings(Section):
    """The log on board."""

    directory: AbsolutePath = "/var/log/phm"
    """Where phm.log (text) and phm.jsonl (the record) are written."""
    max_size: Annotated[Bytes, Field(ge=10e3)] = 5e6
    """A file is rotated at this size."""
    files: Annotated[int, Field(ge=1, le=100)] = 5
    """How many rotated files of phm.log are kept. Those of phm.jsonl are compressed: as many as fit into `files` times `max_size`."""
    sync: Sync = "auto"
    """When events are written through to the disk. `auto`: within a second unless the autopilot reports disarmed; `always`: within a
    second, faults and reports immediately (wears SD cards); `never`: by the system, mostly within 30 s."""


class UnknownContainersSettings(Section):
    """Containers that run on this engine and are not in the configuration."""

    level: UnexpectedLevel = "off"
    """How they are reported. `off`: they are not looked for; `error` opens a fault, which PHM never acts on."""
    ignore: Annotated[list[Annotated[str, Field(min_length=1, max_length=255)]], Field(max_length=100)] = Field(
        default_factory=list
    )
    """Names of containers that may run as well, with `*` and `?`."""


class DockerSettings(Section):
    """The Docker Engine."""

    socket: Annotated[str, Field(pattern=r"^(unix:///.+|tcp://.+)$")] = "unix:///var/run/docker.sock"
    """Its address: unix:///path or tcp://host:port (a socket proxy)."""
    timeout: Annotated[Seconds, Field(gt=0, le=60)] = 5.0
    """Time limit of each call."""
    compare: Annotated[Seconds, Field(ge=0.5, le=60)] = 3.0
    """Seconds between comparisons of the container list, in case the event stream lost an event."""
    container: Name | None = None
    """PHM's own container; default: detected."""
    unknown_containers: UnknownContainersSettings = UnknownContainersSettings()
    """Containers that run on this engine and are not in the configuration."""


class ProcessSettings(Section):
    """PHM's own processes."""

    nice: Annotated[int, Field(ge=-20, le=19)] | None = None
    """Their scheduling priority, if PHM may set it. In a container the CPU weight matters instead. Default: unchanged."""


class CheckSettings(Section):
    """Overrides for one check, by its name as in `phm checks`."""

    enabled: bool = True
    """False: it does not run, and its slot remains unused."""
    period: Annotated[Seconds, Field(ge=0.1)] | None = None
    """Seconds between runs; default: the check's own."""
    deadline: Annotated[Seconds, Field(gt=0)] | None = None
    """Seconds after which a run is overdue (STALE); default: the check's own."""
    failures: Annotated[int, Field(ge=1, le=100)] | None = None
    """How many failed runs in a row open a fault; default: the check's own."""
    needs: list[str] = Field(default_factory=list)
    """Further dependencies: names of checks or ids of units."""
    options: dict[str, Any] = Field(default_factory=dict)
    """Whatever the check itself documents; for checks that are not part of PHM."""
