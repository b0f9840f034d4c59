"""The configuration `phm.yaml` as pydantic models: `Settings` is all of it, each module has one or a few of its sections.

Reading the file, line numbers, variables and error messages are `phm.config`'s. Every field has a description, which is the source
of the JSON schema. Import all models from this package.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from phm.core.settings.agents import AgentId, AgentSettings, SwarmSettings
from phm.core.settings.base import (
    AbsolutePath,
    Bytes,
    Celsius,
    FaultLimit,
    Hertz,
    Limit,
    Name,
    Percent,
    RosName,
    Seconds,
    Section,
)
from phm.core.settings.containers import ContainerSettings, DeviceSettings, FileSettings
from phm.core.settings.daemon import CheckSettings, DockerSettings, LogSettings, ProcessSettings
from phm.core.settings.fleet import FleetEndpoint, FleetSettings, FleetTlsSettings
from phm.core.settings.host import FreeDiskSettings, HostSettings, PressureSettings
from phm.core.settings.mavlink import EndpointSettings, MavlinkSettings, SigningSettings
from phm.core.settings.notify import NotifySettings
from phm.core.settings.recovery import MaintenanceSettings, ManualStop, ManualStopSettings, RecoverySettings
from phm.core.settings.ros import (
    DataSettings,
    DiagnosticsSettings,
    NodeSettings,
    RosSettings,
    TopicSettings,
    WatchedDiagnosticSettings,
)

__all__ = [
    "AbsolutePath",
    "AgentId",
    "AgentSettings",
    "Bytes",
    "Celsius",
    "CheckSettings",
    "ContainerSettings",
    "DataSettings",
    "DeviceSettings",
    "DiagnosticsSettings",
    "DockerSettings",
    "EndpointSettings",
    "FaultLimit",
    "FileSettings",
    "FleetEndpoint",
    "FleetSettings",
    "FleetTlsSettings",
    "FreeDiskSettings",
    "Hertz",
    "HostSettings",
    "Limit",
    "LogSettings",
    "MaintenanceSettings",
    "ManualStop",
    "ManualStopSettings",
    "MavlinkSettings",
    "Name",
    "NodeSettings",
    "NotifySettings",
    "Percent",
    "PressureSettings",
    "ProcessSettings",
    "RecoverySettings",
    "RosName",
    "RosSettings",
    "Seconds",
    "Section",
    "Settings",
    "SigningSettings",
    "SwarmSettings",
    "TopicSettings",
    "WatchedDiagnosticSettings",
]


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
    notify: NotifySettings = NotifySettings()
    """Alerts to other services."""
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
