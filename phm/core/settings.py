"""The configuration `phm.yaml` as pydantic models. Reading the file, line numbers, variables and error messages are `phm.config`'s.

Every field has a description, which is the source of the JSON schema. Durations are seconds, sizes bytes, rates hertz, shares
percent; the YAML may have a unit (`20s`, `500ms`, `5MB`, `10Hz`, `90%`), see `Seconds` and the types below it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, WithJsonSchema, field_validator

from phm.core.maintenance import parse as parse_window

_UNITS: dict[str, dict[str, float]] = {
    "duration": {"ms": 1e-3, "s": 1.0, "min": 60.0, "h": 3600.0},
    "size": {"B": 1, "kB": 1e3, "KB": 1e3, "MB": 1e6, "GB": 1e9, "KiB": 2**10, "MiB": 2**20, "GiB": 2**30},
    "rate": {"mHz": 1e-3, "Hz": 1.0, "kHz": 1e3},
    "share": {"%": 1.0},
    "temperature": {"C": 1.0, "°C": 1.0},
}
_QUANTITY = re.compile(r"^\s*([+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)\s*([A-Za-z%°]*)\s*$")


def _quantity(kind: str) -> Callable[[Any], Any]:
    """A validator that turns `20s` into 20.0, or names the allowed units."""
    units = _UNITS[kind]

    def parse(value: Any) -> Any:
        if isinstance(value, bool):
            raise ValueError(f"is not a {kind}: write a number, or a number with one of {', '.join(units)}")
        if not isinstance(value, str):
            return value
        match = _QUANTITY.match(value)
        if match is None:
            raise ValueError(f"{value!r} is not a {kind}: write a number, or a number with one of {', '.join(units)}")
        number, unit = match.groups()
        if unit and unit not in units:
            raise ValueError(f"{value!r} has the wrong unit {unit!r} for a {kind}: allowed are {', '.join(units)}")
        return float(number) * (units[unit] if unit else 1.0)

    return parse


def _schema(kind: str) -> WithJsonSchema:
    pattern = rf"^\s*[0-9.eE+-]+\s*({'|'.join(_UNITS[kind])})?\s*$"
    return WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string", "pattern": pattern}]})


Seconds = Annotated[float, BeforeValidator(_quantity("duration")), _schema("duration"), Field(allow_inf_nan=False)]
Bytes = Annotated[float, BeforeValidator(_quantity("size")), _schema("size"), Field(allow_inf_nan=False)]
Hertz = Annotated[float, BeforeValidator(_quantity("rate")), _schema("rate"), Field(allow_inf_nan=False)]
Percent = Annotated[float, BeforeValidator(_quantity("share")), _schema("share"), Field(ge=0, le=100)]
Celsius = Annotated[
    float, BeforeValidator(_quantity("temperature")), _schema("temperature"), Field(allow_inf_nan=False)
]
# Docker's rule for names: anything else is a typing mistake.
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]*$", max_length=128)]
RosName = Annotated[str, Field(pattern=r"^/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*$", max_length=255)]
AbsolutePath = Annotated[str, Field(pattern=r"^/", max_length=4096)]


class Section(BaseModel):
    """Base of all sections: unknown keys are refused, values are not converted, and nothing can be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True, use_attribute_docstrings=True, str_strip_whitespace=True)


def _not_a_radio(value: int) -> int:
    if value == 51:
        raise ValueError("51 is the system id of SiK radios: choose another of 1 to 250")
    return value


AgentId = Annotated[int, Field(ge=1, le=250), AfterValidator(_not_a_radio)]


class AgentSettings(Section):
    """Identity of this agent."""

    name: Name = "agent_1"
    """Name of the agent, in logs and displays."""
    id: AgentId = 1
    """Number in the swarm, 1 to 250 but not 51 (taken by SiK radios); the vehicle's MAVLink system id."""


class FileSettings(Section):
    """One file or directory that the application needs."""

    path: AbsolutePath
    """Path inside the container."""
    present: bool = True
    """Whether the path must exist; false: it must not."""
    executable: bool = False
    """True: some execute bit must be set."""
    sha256: Annotated[str, Field(pattern=r"^[0-9a-fA-F]{64}$")] | None = None
    """Expected SHA-256 of the content, 64 hexadecimal digits."""
    restore: Annotated[str, Field(pattern=r"^(image|/.*)$", max_length=4096)] | None = None
    """Where to restore it from: `image` for the container's own image, or a path that PHM sees. Default: never restored."""


class DeviceSettings(Section):
    """One device file of the host that the application uses."""

    path: AbsolutePath
    """Path on the host, e.g. /dev/ttyACM0 or /dev/serial/by-id/..."""
    in_container: AbsolutePath | None = None
    """Path inside the container, if different; the mapping is checked."""
    mapped: bool = True
    """Whether the device must be mapped into the container."""
    open: Literal["auto", "always", "never"] = "auto"
    """Whether to try opening it. `auto` opens everything but serial ports, whose DTR line rises when opened."""


class ContainerSettings(Section):
    """One container of the application."""

    name: Name | None = None
    """The container's name. Give this or `label`."""
    label: Annotated[str, Field(pattern=r"^[^=\s]+(=.*)?$")] | None = None
    """A label, `key` or `key=value`, of exactly one container; for containers that Compose names."""
    alias: Name | None = None
    """Its key in logs and in the rest of this file; default: the name, or the label's value."""
    recover: bool = False
    """Opt-in: PHM may start, restart, unpause and reconnect this container."""
    flight_critical: bool = False
    """True: unless the autopilot reports disarmed, `when_armed` decides about actions on it or that would stop it."""
    when_armed: Literal["advise", "act"] = "advise"
    """For a flight-critical container unless disarmed: `advise` recommends the action (an operator may approve it), `act` takes it."""
    after: list[Name] = Field(default_factory=list)
    """Containers that must start before this one; when PHM restarts one of them, this one is restarted after it."""
    healthcheck: Literal["auto", "required", "ignore"] = "auto"
    """`auto`: evaluated when the image has a HEALTHCHECK, else BYPASS. `required`: a missing HEALTHCHECK is an error."""
    pressure: Literal["auto", "ignore"] = "auto"
    """`ignore`: no alarm when it lacks CPU, memory or I/O, e.g. because a CPU limit is meant to slow it down."""
    networks: list[Name] = Field(default_factory=list)
    """Networks it must be connected to; PHM joins them itself."""
    address: bool = True
    """Whether its address on those networks must respond."""
    files: list[FileSettings] = Field(default_factory=list)
    """Files that the application needs."""
    devices: list[DeviceSettings] = Field(default_factory=list)
    """Devices that it uses."""

    @property
    def key(self) -> str:
        """Its name in unit ids, targets and logs."""
        return self.alias or self.name or (self.label or "").rpartition("=")[2]


class NodeSettings(Section):
    """One ROS node that must run."""

    name: RosName
    """Full name, e.g. /agent_1/node_1 (a missing first slash is added)."""
    container: Name | None = None
    """The container it runs in; default: the only configured one. Recovery restarts it."""
    process: list[Annotated[str, Field(min_length=1, max_length=255)]] = Field(default_factory=list)
    """Words that all occur in the command line of its process, and of no other in its container; default: detected."""
    relaunch: list[str] = Field(default_factory=list)
    """Command, word by word, that starts this node inside its container; tried before the container is restarted."""
    beacon: Literal["auto", "required"] = "auto"
    """`required`: it is an error when the node runs and no beacon (`phm.beacon`) is received from it."""
    commands: bool = False
    """True: commands from the ground pass through this node to the autopilot, so it is part of the command path."""


class TopicSettings(Section):
    """One ROS topic that must have data."""

    name: RosName
    """Full name, e.g. /agent_1/topic_1 (a missing first slash is added)."""
    type: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*$")] | None = None
    """Expected type, e.g. std_msgs/msg/String; default: not checked."""
    rate: Annotated[Hertz, Field(ge=0)] | None = None
    """Expected rate in Hz; 0 for a latched topic (only its publisher is checked); default: not checked."""
    tolerance: Percent = 10.0
    """Deviation of the rate for WARN."""
    error_tolerance: Percent | None = None
    """Deviation of the rate for ERROR; default: twice `tolerance`."""
    silence: Annotated[Seconds, Field(gt=0, le=600)] | None = None
    """Replaces `ros.silence` for this topic."""
    publishers: list[RosName] = Field(default_factory=list)
    """Nodes that must publish it; default: any node."""
    subscribers: list[RosName] = Field(default_factory=list)
    """Nodes that must subscribe to it; default: none."""
    container: Name | None = None
    """The container it comes from; default: that of its first publisher, else the only configured one."""

    @property
    def error_limit(self) -> float:
        """Deviation of the rate for ERROR, percent."""
        return 2 * self.tolerance if self.error_tolerance is None else self.error_tolerance


class WatchedDiagnosticSettings(Section):
    """Statuses of the application on /diagnostics that are evaluated together."""

    name: Annotated[str, Field(min_length=1, max_length=255)]
    """Name of the status, e.g. `camera: Frequency`, or a pattern with `*` and `?`; the worst of all that match counts."""
    container: Name | None = None
    """The container it comes from; default: that of its node, else the only configured one."""
    node: RosName | None = None
    """The node that publishes it; default: the configured node whose name precedes the colon, if any."""
    timeout: Annotated[Seconds, Field(ge=0.5, le=600)] = 5.0
    """A status not received for this long is stale."""
    when_stale: Literal["error", "warn", "stale"] = "error"
    """Level of a stale status, also of one that was never received or reports STALE itself. `stale` opens no fault."""


class DiagnosticsSettings(Section):
    """ROS diagnostics: publishing PHM's status, and monitoring the application's."""

    publish: bool | None = None
    """True: PHM publishes its status on /diagnostics. Default: when anything else of `ros` is configured."""
    listen: Annotated[list[RosName], Field(max_length=4)] = Field(default_factory=lambda: ["/diagnostics"])
    """Topics of diagnostic_msgs/DiagnosticArray that are read."""
    watch: list[WatchedDiagnosticSettings] = Field(default_factory=list)
    """Statuses that must exist and be OK."""


class RosSettings(Section):
    """The ROS graph of this agent."""

    domain: Annotated[int, Field(ge=0, le=232)] | None = None
    """ROS_DOMAIN_ID; default: that of PHM's environment, else 0."""
    nodes: list[NodeSettings] = Field(default_factory=list)
    """Nodes that must run."""
    topics: list[TopicSettings] = Field(default_factory=list)
    """Topics that must have data."""
    diagnostics: DiagnosticsSettings = DiagnosticsSettings()
    """ROS diagnostics, out and in."""
    grace: Annotated[Seconds, Field(ge=0, le=120)] = 8.0
    """Seconds after a start or restart in which an incomplete graph is not yet a fault."""
    silence: Annotated[Seconds, Field(gt=0, le=60)] = 3.0
    """A topic without a message for max(three periods, this) is silent; sooner if it never paused for so long."""
    max_memory: Annotated[Bytes, Field(ge=50e6)] = 250e6
    """The ROS child process is replaced when it uses more."""
    installs: list[Annotated[str, Field(pattern=r"^/[^:]*$", max_length=4096)]] = Field(default_factory=list)
    """Directories `install/` of the application's workspaces, mounted for PHM, for message types that it cannot read otherwise."""

    @property
    def used(self) -> bool:
        return bool(self.nodes or self.topics or self.diagnostics.watch or self.diagnostics.publish)

    @property
    def publishes(self) -> bool:
        """Whether PHM publishes its status on /diagnostics."""
        return self.used if self.diagnostics.publish is None else self.diagnostics.publish


class EndpointSettings(Section):
    """One MAVLink connection."""

    url: Annotated[str, Field(min_length=1, max_length=512)]
    """pymavlink's form: udpout:HOST:PORT, udpin:HOST:PORT, udpbcast:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT, or /dev/tty... for serial."""
    link_id: Annotated[int, Field(ge=0, le=255)] | None = None
    """Link id of signed messages, unique for each connection of an agent; default: its position in the list, from 0."""
    baud: Annotated[int, Field(ge=1200, le=4_000_000)] = 57600
    """Serial only: bits per second."""
    budget: Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)] = 158
    """Bytes a second that PHM may send on this link, for the entire swarm together; 0: no limit. The default is 5 %
    of the capacity of a 64 kbit/s telemetry radio."""
    name: Name | None = None
    """Its name in logs; default: the url."""
    leads_to: Literal["both", "router", "ground", "autopilot", "peers"] = "both"
    """What is at its other end. `both`: the autopilot, which forwards frames to the ground; `router`: a MAVLink router that
    connects both; `peers`: the other agents, and neither ground nor autopilot."""
    radio: Literal["auto", "required", "off"] = "auto"
    """Whether a telemetry radio that sends RADIO_STATUS is behind it; `auto`: required once RADIO_STATUS was received."""
    container: Name | None = None
    """Key of the configured container at its other end, such as a MAVLink router's. Its faults are reported there, and when it
    is started the connection is retried immediately. Default: none."""

    @property
    def key(self) -> str:
        return self.name or self.url

    @property
    def serial(self) -> bool:
        """Whether it is a serial port; else it is a socket."""
        return self.url.startswith("/")

    @property
    def to_ground(self) -> bool:
        return self.leads_to not in ("autopilot", "peers")

    @property
    def to_autopilot(self) -> bool:
        return self.leads_to not in ("ground", "peers")

    @field_validator("url")
    @classmethod
    def _known_form(cls, value: str) -> str:
        scheme, _, rest = value.partition(":")
        if value.startswith("/"):
            return value
        if scheme not in ("udpin", "udpout", "udpbcast", "tcp", "tcpin"):
            raise ValueError(
                f"{value!r} is not a MAVLink endpoint: allowed are udpout:HOST:PORT, udpin:HOST:PORT, "
                "udpbcast:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT and a device path such as /dev/ttyUSB0"
            )
        host, _, port = rest.rpartition(":")
        if not host or not port.isdecimal() or not 1 <= int(port) <= 65535:
            raise ValueError(f"{value!r} needs a host and a port of 1 to 65535, e.g. {scheme}:127.0.0.1:14550")
        return value


class SigningSettings(Section):
    """MAVLink 2 message signing."""

    key: AbsolutePath | None = None
    """File with the key, 32 bytes or 64 hexadecimal digits, that only its owner can read. Default: signing is off."""
    unsigned: Literal["vehicle", "all", "none"] = "vehicle"
    """Which unsigned messages are accepted while signing is on; unsigned commands never are."""
    command_age: Annotated[Seconds, Field(ge=1, le=300)] = 10.0
    """A signed command is refused when it is older."""


class MavlinkSettings(Section):
    """MAVLink: status to the ground, commands from it."""

    endpoints: list[EndpointSettings] = Field(default_factory=list)
    """Connections; each is reopened when it is lost. Without any, nothing is sent."""
    component_id: Annotated[int, Field(ge=2, le=250)] = 193
    """MAVLink component id of PHM. 191 is used by MAVROS and MAVSDK, 194 by BlueOS, 1 is the autopilot."""
    heartbeat: Annotated[Seconds, Field(ge=0.2, le=60)] | None = None
    """Seconds between HEARTBEATs, each with the status word; default: by the number of agents, 2 s for up to 8."""
    refresh: Annotated[Seconds, Field(ge=1)] | None = None
    """Seconds between repeats of the status line; default: by the number of agents, 10 s for up to 8."""
    gcs_timeout: Annotated[Seconds, Field(ge=1)] = 10.0
    """A ground station that was received and is silent for longer is reported as lost."""
    autopilot: bool = False
    """True: an autopilot must be received on these endpoints; else it is a fault."""
    autopilot_timeout: Annotated[Seconds, Field(ge=2, le=60)] = 3.5
    """An autopilot that was received and is silent for longer is reported as lost, and no longer as disarmed. It sends one
    HEARTBEAT a second."""
    radio_timeout: Annotated[Seconds, Field(ge=2, le=120)] = 5.0
    """A radio without RADIO_STATUS for longer, and for longer than 2.5 of its own periods, is reported as lost."""
    radio_margin: Annotated[float, Field(ge=0, le=254, allow_inf_nan=False)] = 15.0
    """WARN below this margin of signal over noise at either end, in the radio's units (SiK: 1.9 to a dB)."""
    radio_errors: Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)] = 5.0
    """WARN above so many damaged packets a second (RADIO_STATUS.rxerrors); 0: not checked."""
    loss: Percent = 20.0
    """WARN when more frames from the other end of a serial port are lost, by gaps in its sequence numbers."""
    commands: list[Literal["status", "details", "check", "approve", "restart"]] = Field(default=["status", "details"])
    """What the ground may request by MAVLink commands; the first two only read. See docs/reference/mavlink.md."""
    signing: SigningSettings = SigningSettings()
    """Signed messages."""


class SwarmSettings(Section):
    """The other agents, received over MAVLink."""

    agents: list[AgentId] = Field(default_factory=list, max_length=250)
    """Ids of all agents of the swarm; one that is not received is reported as missing. Default: all agents ever received."""


FleetEndpoint = Annotated[
    str, Field(pattern=r"^(tcp|tls|quic)/([A-Za-z0-9_.-]+|\[[0-9A-Fa-f:.]+\]):[0-9]{1,5}$", max_length=300)
]


class FleetTlsSettings(Section):
    """Certificates for endpoints `tls/` and `quic/`, as files in PEM."""

    ca: AbsolutePath | None = None
    """Of the authority that the routers' certificates come from; default: those that the system trusts."""
    certificate: AbsolutePath | None = None
    """This agent's own, for routers that ask for one."""
    key: AbsolutePath | None = None
    """The private key of `certificate`."""
    verify_name: bool = True
    """Whether a router's certificate must be for the host in `connect`."""


class FleetSettings(Section):
    """The same status over Zenoh, for fleets on IP; needs the extra `fleet`."""

    enabled: bool = False
    """True: the status is published."""
    name: Name = "fleet"
    """Of the fleet; the second part of each key."""
    mode: Literal["client", "peer"] = "client"
    """`client`: through a router; `peer`: also directly to other peers."""
    connect: Annotated[list[FleetEndpoint], Field(max_length=16)] = Field(default_factory=list)
    """Routers (or peers): tcp/HOST:PORT, tls/HOST:PORT, quic/HOST:PORT. A client uses the first that answers."""
    listen: Annotated[list[FleetEndpoint], Field(max_length=4)] = Field(default_factory=list)
    """Where a peer takes connections, e.g. tcp/0.0.0.0:7447."""
    refresh: Annotated[Seconds, Field(ge=1, le=3600)] = 10.0
    """Seconds after which an unchanged status is published again."""
    deadline: Annotated[Seconds, Field(ge=0.5, le=60)] = 5.0
    """Limit of each attempt to connect, for each endpoint; a fleet that is unreachable for two of these is reported."""
    lease: Annotated[Seconds, Field(ge=1, le=300)] = 10.0
    """A connection that is silent for so long counts as lost at both ends, and so does the agent behind it."""
    tls: FleetTlsSettings = FleetTlsSettings()
    """Certificates."""


class Limit(Section):
    """A pair of limits; `warn` must not be above `error`."""

    warn: Percent
    """WARN from here."""
    error: Percent
    """ERROR from here."""


class FreeDiskSettings(Section):
    """Files that PHM may delete when their disk is full."""

    path: AbsolutePath
    """Directory, as PHM sees it; it must be mounted writable, and PHM must be allowed to delete its files."""
    files: Annotated[list[Annotated[str, Field(min_length=1, max_length=255, pattern=r"^[^/]+$")]], Field(min_length=1)]
    """Names, or patterns with `*` and `?`, of the files that may be deleted, in the directory and below."""
    older_than: Annotated[Seconds, Field(ge=10)] = 600.0
    """Seconds since the last change of a file before it may be deleted; PHM must have monitored the clock for as long."""


class HostSettings(Section):
    """Limits for the companion computer."""

    cpu: Limit = Limit(warn=90, error=98)
    """Share of all cores in use, averaged over `cpu_window`."""
    cpu_window: Annotated[Seconds, Field(ge=1, le=600)] = 10.0
    """Seconds over which CPU use is averaged."""
    cpu_quick: Annotated[Seconds, Field(ge=0, le=600)] = 2.0
    """Shorter window for when no core was idle and tasks had to wait for one, seconds; 0: not used."""
    memory: Limit = Limit(warn=85, error=95)
    """Share of memory that is not available."""
    disk: Limit = Limit(warn=85, error=95)
    """Share of each disk in use."""
    disks: list[AbsolutePath] = Field(default_factory=lambda: ["/"])
    """Paths whose disks are watched, as PHM sees them."""
    free_disk: Annotated[list[FreeDiskSettings], Field(max_length=16)] = Field(default_factory=list)
    """What may be deleted when one of them is full, oldest first."""
    temperature_warn: Celsius = 75.0
    """Degrees Celsius of the hottest sensor of the processor for WARN (a Pi throttles at 80)."""
    temperature_error: Celsius = 85.0
    """Degrees Celsius for ERROR."""
    clock_step: Annotated[Seconds, Field(gt=0)] = 2.0
    """A jump of the UTC clock by more than this is a WARN."""
    dev_root: AbsolutePath = "/dev"
    """Where the host's /dev is mounted in PHM's container (docker/compose.yaml: /host/dev)."""


class FaultLimit(Section):
    """A pair of limits of a frequency; `warn` must not be above `error`."""

    warn: Annotated[Hertz, Field(gt=0)]
    """WARN from here."""
    error: Annotated[Hertz, Field(gt=0)]
    """ERROR from here."""


class PressureSettings(Section):
    """When a container or the computer lacks CPU, memory, I/O or processes."""

    window: Annotated[Seconds, Field(ge=1, le=60)] = 2.0
    """Seconds over which the counters of a container are compared."""
    throttled: Limit = Limit(warn=25, error=50)
    """Share of time in which a container is throttled by its CPU limit."""
    waiting: Limit = Limit(warn=75, error=90)
    """Share of time in which all of a container's runnable tasks wait for a CPU, because others use them."""
    memory: Limit = Limit(warn=40, error=60)
    """Share of time in which all of a container waits for memory."""
    memory_faults: FaultLimit = FaultLimit(warn=50, error=200)
    """Pages a second that a container must read back because its memory limit left no room for them."""
    io: Limit = Limit(warn=50, error=75)
    """Share of time in which all of a container waits for the disk, over at least 5 s."""
    pids: Limit = Limit(warn=90, error=100)
    """Share of a container's limit of processes and threads in use."""
    host_memory: Limit = Limit(warn=10, error=30)
    """Share of time in which all of the computer waits for memory, over `host_window`."""
    host_io: Limit = Limit(warn=70, error=95)
    """Share of time in which all of the computer waits for its disks, over `host_window`."""
    host_window: Annotated[Seconds, Field(ge=1, le=600)] = 10.0
    """Seconds over which the two are averaged."""
    cgroups: AbsolutePath = "/sys/fs/cgroup"
    """Where the host's /sys/fs/cgroup is mounted in PHM's container (docker/compose.yaml: /host/cgroup)."""


class ManualStopSettings(Section):
    """How to treat a stop by an operator (`docker stop`, `docker compose stop`, `down`)."""

    ground: Literal["heal", "advise", "respect"] = "respect"
    """While the autopilot reports that it is disarmed."""
    air: Literal["heal", "advise", "respect"] = "heal"
    """While it is armed, or its armed state is not known."""


def _for_both(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    if value not in _RULE["enum"]:
        raise ValueError(
            f"{value[:60]!r} is not a rule: allowed are heal, advise and respect, or one each for ground and air"
        )
    return {"ground": value, "air": value}


_RULE: dict[str, Any] = {"enum": ["heal", "advise", "respect"], "type": "string"}
ManualStop = Annotated[
    ManualStopSettings,
    BeforeValidator(_for_both),
    WithJsonSchema(
        {
            "anyOf": [
                _RULE,
                {"type": "object", "properties": {"ground": _RULE, "air": _RULE}, "additionalProperties": False},
            ]
        }
    ),
]


def _window(value: str) -> str:
    parse_window(value)
    return value


class MaintenanceSettings(Section):
    """A time in which a container, or all, is on hold; not while the autopilot is armed."""

    when: Annotated[str, AfterValidator(_window)]
    """`[DAYS or DATE] HH:MM-HH:MM` in UTC, e.g. `sun 02:00-04:00`, `mon-fri 12:00-12:30`, `2026-11-22 22:00-01:00`."""
    container: Name | None = None
    """Key of the container; default: all."""
    reason: Annotated[str, Field(max_length=200)] = ""
    """Shown with the hold."""


class RecoverySettings(Section):
    """What PHM may do about faults. Only containers with `recover: true` are ever touched."""

    mode: Literal["act", "advise", "off"] = "act"
    """`act`: take actions; `advise`: only recommend them; `off`: neither. PHM joins networks itself in any mode."""
    backoff: Annotated[Seconds, Field(gt=0)] = 1.0
    """Seconds before the second attempt; doubled for each further one."""
    backoff_max: Annotated[Seconds, Field(gt=0)] = 60.0
    """Longest wait between attempts."""
    budget: Annotated[int, Field(ge=1, le=100)] = 5
    """Most actions on one container within `window`."""
    reserve: Annotated[int, Field(ge=0, le=99)] = 1
    """How many of them are reserved for a container that is down. Beyond the budget, such a container is still started, but only
    once per `backoff_max`."""
    window: Annotated[Seconds, Field(ge=1)] = 600.0
    """Seconds over which the budget counts."""
    same_failure: Annotated[int, Field(ge=1, le=100)] = 3
    """After the same failure this many times: give up, report it, and leave it to the operator."""
    verify: Annotated[Seconds, Field(ge=1)] = 30.0
    """Seconds within which the check must be OK again after an action; else the action has failed."""
    stop_timeout: Annotated[Seconds, Field(ge=0, le=300)] = 5.0
    """Seconds between the stop signal and SIGKILL when PHM restarts a container. A container that asks for more time itself
    (`stop_grace_period` in Compose) gets it, up to 2 min."""
    patience: Annotated[Seconds, Field(ge=0, le=600)] = 10.0
    """Seconds for which a topic must have been silent or slow, lost a publisher or subscriber or had incompatible ones while its
    nodes are alive, or a node must have been duplicate, before an action is taken."""
    approval: Annotated[Seconds, Field(ge=5, le=600)] = 60.0
    """Seconds for which an approval is valid; after that the action must be approved again."""
    on_manual_stop: ManualStop = ManualStopSettings()
    """How to treat a container that an operator stopped or removed. `heal`: like a failure; `advise`: raise an alarm and only
    recommend an action; `respect`: put it on hold. One value, or one each for `ground` and `air`."""
    hold: Annotated[Seconds, Field(ge=1, le=86400)] = 600.0
    """How long a hold lasts without `phm hold --for`, and after a stop that is respected."""
    hold_max: Annotated[Seconds, Field(ge=1, le=86400)] = 14400.0
    """The longest hold that `phm hold` accepts."""
    relieve: Annotated[list[Name], Field(max_length=16)] = Field(default_factory=list)
    """Containers, none of them flight-critical, whose CPU weight is lowered while a flight-critical container with
    `recover: true` waits for a CPU because of others, and restored afterwards."""
    maintenance: Annotated[list[MaintenanceSettings], Field(max_length=16)] = Field(default_factory=list)
    """Times in which containers are on hold. A container's label `phm.maintenance` has the same effect."""
    ladders: dict[str, list[str]] = Field(default_factory=dict)
    """Per condition, the actions in order, replacing the built-in ladder, e.g. `unhealthy: [restart]`."""


class LogSettings(Section):
    """The log on board."""

    directory: AbsolutePath = "/var/log/phm"
    """Where phm.log (text) and phm.jsonl (the record) are written."""
    max_size: Annotated[Bytes, Field(ge=10e3)] = 5e6
    """A file is rotated at this size."""
    files: Annotated[int, Field(ge=1, le=100)] = 5
    """How many rotated files of each kind are kept."""
    sync: bool = False
    """True: fsync after each fault and report (survives power loss, but wears SD cards)."""


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


class Settings(Section):
    """All of `phm.yaml`."""

    agent: AgentSettings = AgentSettings()
    """Identity of this agent."""
    interval: Annotated[Seconds, Field(ge=1, le=3600)] = 20.0
    """Reactivation interval: seconds between full passes. The environment's PHM_INTERVAL overrides it."""
    containers: list[ContainerSettings] = Field(default_factory=list)
    """The application's containers."""
    ros: RosSettings = RosSettings()
    """The ROS graph."""
    mavlink: MavlinkSettings = MavlinkSettings()
    """Links to the ground and the autopilot."""
    swarm: SwarmSettings = SwarmSettings()
    """The other agents."""
    fleet: FleetSettings = FleetSettings()
    """The same status over Zenoh."""
    host: HostSettings = HostSettings()
    """Limits for the companion computer."""
    pressure: PressureSettings = PressureSettings()
    """Limits of pressure on containers and on the computer."""
    recovery: RecoverySettings = RecoverySettings()
    """Automatic recovery."""
    log: LogSettings = LogSettings()
    """The log on board."""
    docker: DockerSettings = DockerSettings()
    """The Docker Engine."""
    process: ProcessSettings = ProcessSettings()
    """PHM's own processes."""
    checks: dict[str, CheckSettings] = Field(default_factory=dict)
    """Overrides by check name."""
    state_dir: AbsolutePath = "/var/lib/phm"
    """Where open faults, budgets and holds are kept across restarts of PHM (on a disk that survives power loss)."""
    run_dir: AbsolutePath = "/run/phm"
    """Where the running daemon keeps its status for `phm status` (in memory: a tmpfs)."""

    def container(self, key: str) -> ContainerSettings | None:
        return next((entry for entry in self.containers if entry.key == key), None)

    def container_of_node(self, name: str) -> str:
        """Key of the container that runs the node, or empty when it cannot be known."""
        wanted = name.lstrip("/")
        for node in self.ros.nodes:
            if node.name.lstrip("/") == wanted and node.container:
                return node.container
        return self.containers[0].key if len(self.containers) == 1 else ""

    def container_of_topic(self, topic: TopicSettings) -> str:
        """Key of the container that the topic comes from, or empty when it cannot be known."""
        if topic.container:
            return topic.container
        return self.container_of_node(topic.publishers[0] if topic.publishers else "")
