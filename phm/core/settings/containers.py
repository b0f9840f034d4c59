"""Section `containers`."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from phm.core.settings.base import AbsolutePath, Name, Section
from phm.core.settings.readiness import ReadySettings


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
    manifest: AbsolutePath | None = None
    """For a folder: file with the SHA-256 of each file in it, as `phm learn` or sha256sum writes it. A relative path is relative
    to this configuration."""
    ignore: Annotated[list[Annotated[str, Field(min_length=1, max_length=255)]], Field(max_length=100)] = Field(
        default_factory=list
    )
    """Files and folders that the manifest does not cover: names or relative paths with `*` and `?`."""


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
    ready: ReadySettings | None = None
    """What it must provide to be ready; default: readiness is not checked."""
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
