"""The configuration `phm.yaml` as pydantic models: `Settings` is all of it, each module has one or a few of its sections.

Reading the file, line numbers, variables and error messages are `phm.config`'s. Every field has a description, which is the source
of the JSON schema. Import all models from this package.
"""

from __future__ import annotations

from collections.abc import Callable
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
from phm.core.settings.custom import (
    CommandCheckSettings,
    CustomBase,
    CustomCheckSettings,
    CustomRecoverySettings,
    HttpCheckSettings,
    LifecycleCheckSettings,
    LogCheckSettings,
    MavlinkCheckSettings,
    ProcessCheckSettings,
    SerialCheckSettings,
    ServiceCheckSettings,
    TcpCheckSettings,
    TopicCheckSettings,
)
from phm.core.settings.daemon import CheckSettings, DockerSettings, LogSettings, ProcessSettings
from phm.core.settings.delivery import DeliverySettings
from phm.core.settings.fleet import FleetEndpoint, FleetSettings, FleetTlsSettings
from phm.core.settings.host import FreeDiskSettings, HostSettings, PressureSettings
from phm.core.settings.mavlink import EndpointSettings, MavlinkSettings, SigningSettings
from phm.core.settings.metrics import MetricsSettings
from phm.core.settings.notify import NotifySettings
from phm.core.settings.readiness import NodeReadySettings, ReadySettings
from phm.core.settings.recovery import MaintenanceSettings, ManualStop, ManualStopSettings, RecoverySettings
from phm.core.settings.ros import (
    DataSettings,
    DiagnosticsSettings,
    NodeSettings,
    RosSettings,
    TopicSettings,
    WatchedDiagnosticSettings,
)
from phm.core.settings.trends import TrendSettings

__all__ = [
    "AbsolutePath",
    "AgentId",
    "AgentSettings",
    "Bytes",
    "Celsius",
    "CheckSettings",
    "CommandCheckSettings",
    "ContainerSettings",
    "CustomBase",
    "CustomCheckSettings",
    "CustomRecoverySettings",
    "DataSettings",
    "DeliverySettings",
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
    "HttpCheckSettings",
    "LifecycleCheckSettings",
    "Limit",
    "LogCheckSettings",
    "LogSettings",
    "MaintenanceSettings",
    "ManualStop",
    "ManualStopSettings",
    "MavlinkCheckSettings",
    "MavlinkSettings",
    "MetricsSettings",
    "Name",
    "NodeReadySettings",
    "NodeSettings",
    "NotifySettings",
    "Percent",
    "PressureSettings",
    "ProcessCheckSettings",
    "ProcessSettings",
    "ReadySettings",
    "RecoverySettings",
    "RosName",
    "RosSettings",
    "Seconds",
    "Section",
    "SerialCheckSettings",
    "ServiceCheckSettings",
    "Settings",
    "SigningSettings",
    "SwarmSettings",
    "TcpCheckSettings",
    "TopicCheckSettings",
    "TopicSettings",
    "TrendSettings",
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
    trends: TrendSettings = TrendSettings()
    """Warnings of what will fail at the present rate."""
    recovery: RecoverySettings = RecoverySettings()
    """Automatic recovery."""
    log: LogSettings = LogSettings()
    """The log on board."""
    notify: NotifySettings = NotifySettings()
    """Alerts to other services."""
    custom: Annotated[list[CustomCheckSettings], Field(max_length=64)] = Field(default_factory=list)
    """User-defined checks without code."""
    metrics: MetricsSettings = MetricsSettings()
    """Measurements for Prometheus."""
    delivery: DeliverySettings = DeliverySettings()
    """New configurations over IP."""
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

    @property
    def command_container(self) -> str:
        """Key of the container through which commands pass to the autopilot; empty when it cannot be known, or there is none."""
        found = self._command_containers()
        return found[0] if len(found) == 1 else ""

    @property
    def command_nodes(self) -> list[str]:
        """Names of the nodes through which commands may pass: those with `commands`, else those of the container, and where no
        container may be the one, those without a container, e.g. on the host."""
        marked = [node.name for node in self.ros.nodes if node.commands]
        found = self._command_containers()
        if marked or len(found) > 1 or self.mavlink.application == "none":
            return marked
        return [node.name for node in self.ros.nodes if self.container_of_node(node.name) == "".join(found)]

    @property
    def command_path_unclear(self) -> bool:
        """Whether several containers, or none with nodes, may be the one through which commands pass, and the configuration does
        not name it."""
        if self.command_nodes or self.mavlink.application == "none":
            return False
        found = self._command_containers()
        return len(found) > 1 or bool(self.ros.nodes and not found)

    def _command_containers(self) -> list[str]:
        """The containers that may pass commands on: not those at the other end of an endpoint, such as a router's. A rule that
        none or all of them follow does not decide."""
        if self.mavlink.application not in ("auto", "none"):
            return [self.mavlink.application]
        if self.mavlink.application == "none":
            return []
        routers = [entry for entry in self.containers if entry.key in {end.container for end in self.mavlink.endpoints}]
        found = [entry for entry in self.containers if entry not in routers]
        with_nodes = {self.container_of_node(node.name) for node in self.ros.nodes}
        networks = {name for entry in routers for name in entry.networks}
        rules: tuple[Callable[[ContainerSettings], bool], ...] = (
            lambda entry: entry.flight_critical,
            lambda entry: entry.key in with_nodes,
            lambda entry: bool(networks.intersection(entry.networks)),
        )
        for rule in rules:
            found = [entry for entry in found if rule(entry)] or found
        return [entry.key for entry in found]

    def container_of_topic(self, topic: TopicSettings) -> str:
        """Key of the container that the topic comes from, or empty when it cannot be known."""
        if topic.container:
            return topic.container
        return self.container_of_node(topic.publishers[0] if topic.publishers else "")
