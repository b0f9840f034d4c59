"""Section `mavlink`."""

from __future__ import annotations

import re
from typing import Annotated, Literal

from pydantic import Field, field_validator

from phm.core.settings.base import AbsolutePath, Name, Percent, Seconds, Section
from phm.core.settings.hosts import check_host

_SPEED = re.compile(r"[:,][0-9]{4,}$")
"""How MAVProxy and MAVROS write a speed. Names in /dev/serial/by-path have colons too, before shorter numbers."""


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
            if _SPEED.search(value):
                raise ValueError(f"{value!r} ends with a speed: write the path alone, the speed is the key 'baud'")
            return value
        if scheme not in ("udpin", "udpout", "udpbcast", "tcp", "tcpin"):
            raise ValueError(
                f"{value!r} is not a MAVLink endpoint: allowed are udpout:HOST:PORT, udpin:HOST:PORT, "
                "udpbcast:HOST:PORT, tcp:HOST:PORT, tcpin:HOST:PORT and a device path such as /dev/ttyUSB0"
            )
        if rest.startswith("/"):
            raise ValueError(f"{value!r}: write {scheme}:HOST:PORT, without //")
        host, _, port = rest.rpartition(":")
        if not host.strip("[]") or not port.isdecimal() or not 1 <= int(port) <= 65535:
            raise ValueError(f"{value!r} needs a host and a port of 1 to 65535, e.g. {scheme}:127.0.0.1:14550")
        try:
            check_host(host)
        except ValueError as error:
            raise ValueError(f"{value!r}: {error}") from error
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
    pilots: Annotated[list[Annotated[int, Field(ge=1, le=255)]], Field(max_length=16)] = Field(default_factory=list)
    """System ids of the ground stations whose loss is reported. Default: every ground station but `phm gcs`, which counts only if
    it is listed or runs with --pilot."""
    application: Name = "auto"
    """Key of the container through which commands pass to the autopilot, so that it is part of the command path. `auto`: inferred
    unless `ros.nodes[].commands` names nodes, and then the only value; `none`: there is none."""
    autopilot: bool = False
    """True: an autopilot must be received on these endpoints; else it is a fault."""
    autopilot_timeout: Annotated[Seconds, Field(ge=2, le=60)] = 3.5
    """An autopilot that was received and is silent for longer is reported as lost, and no longer as disarmed. It sends one
    HEARTBEAT a second."""
    request_boot_time: bool = False
    """True: PHM requests SYSTEM_TIME once a second from an autopilot that sends no time since boot, to distinguish immediately
    whether it hung, rebooted, or only the link was stuck. False: PHM does not request it."""
    radio_timeout: Annotated[Seconds, Field(ge=2, le=120)] = 5.0
    """A radio without RADIO_STATUS for longer, and for longer than 2.5 of its own periods, is reported as lost."""
    radio_margin: Annotated[float, Field(ge=0, le=254, allow_inf_nan=False)] = 15.0
    """WARN below this margin of signal over noise at either end, in the radio's units (SiK: 1.9 to a dB)."""
    radio_errors: Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)] = 5.0
    """WARN above this many damaged packets a second (RADIO_STATUS.rxerrors); 0: not checked."""
    loss: Percent = 20.0
    """WARN when more frames from the other end of a serial port are lost, by gaps in its sequence numbers."""
    commands: list[Literal["status", "details", "check", "approve", "restart", "hold"]] = Field(
        default=["status", "details"]
    )
    """What the ground may request by MAVLink commands; `status` and `details` are read-only. See docs/reference/mavlink.md."""
    signing: SigningSettings = SigningSettings()
    """Signed messages."""
