"""Facts that probes report, and the protocols through which checks query the probes.

Probes report what they observe and never judge it. Each method has its own deadline. It raises
`CannotTell` with a sentence if it cannot find out: the check is then STALE, and no recovery
follows. Times named `age_s` are seconds before the call on the monotonic clock.
"""

from __future__ import annotations

from dataclasses import dataclass

from phm.core.clock import Clock
from phm.facts.daemon import SelfFact as SelfFact, SelfProbe as SelfProbe
from phm.facts.docker import (
    COMPLETE as COMPLETE,
    Attachment as Attachment,
    ContainerFact as ContainerFact,
    DeviceMapping as DeviceMapping,
    DockerProbe as DockerProbe,
    EventStreamFact as EventStreamFact,
    FailedProbe as FailedProbe,
    HealthcheckFact as HealthcheckFact,
    Mount as Mount,
    OtherContainer as OtherContainer,
    ProcessFact as ProcessFact,
)
from phm.facts.errors import (
    CannotTell as CannotTell,
    NoAccess as NoAccess,
    NoResponse as NoResponse,
    NotPermitted as NotPermitted,
)
from phm.facts.files import (
    DeviceFact as DeviceFact,
    DeviceProbe as DeviceProbe,
    FileFact as FileFact,
    FileProbe as FileProbe,
    TreeFact as TreeFact,
)
from phm.facts.host import DiskFact as DiskFact, HostFact as HostFact, HostProbe as HostProbe
from phm.facts.links import (
    AutopilotFact as AutopilotFact,
    GcsFact as GcsFact,
    LineFact as LineFact,
    LinkFact as LinkFact,
    LinkProbe as LinkProbe,
    RadioFact as RadioFact,
    SenderFact as SenderFact,
)
from phm.facts.logs import LogFact as LogFact, LogMemory as LogMemory, LogProbe as LogProbe
from phm.facts.mavlink_messages import MessageProbe as MessageProbe, MessageValue as MessageValue
from phm.facts.pressure import (
    CgroupState as CgroupState,
    ConsumerFact as ConsumerFact,
    PressureFact as PressureFact,
    PressureProbe as PressureProbe,
    StallFact as StallFact,
)
from phm.facts.programs import ProgramFact as ProgramFact, ProgramProbe as ProgramProbe
from phm.facts.ros import (
    AnswerFact as AnswerFact,
    BeaconFact as BeaconFact,
    DataFact as DataFact,
    DiagnosticFact as DiagnosticFact,
    EndpointFact as EndpointFact,
    FieldFact as FieldFact,
    NameFact as NameFact,
    NeighbourFact as NeighbourFact,
    OutsideFact as OutsideFact,
    RateFact as RateFact,
    Reception as Reception,
    RosFact as RosFact,
    RosProbe as RosProbe,
    TopicFact as TopicFact,
)
from phm.facts.ros_environment import (
    EnvironmentDifference as EnvironmentDifference,
    EnvironmentProbe as EnvironmentProbe,
    RosEnvironment as RosEnvironment,
    ros_variables as ros_variables,
)
from phm.facts.serial_ports import SerialFact as SerialFact, SerialProbe as SerialProbe
from phm.facts.sockets import ConnectionFact as ConnectionFact, HttpFact as HttpFact, SocketProbe as SocketProbe
from phm.facts.swarm import (
    PeerFact as PeerFact,
    SwarmFact as SwarmFact,
    SwarmProbe as SwarmProbe,
)


@dataclass(frozen=True)
class World:
    """All probes that a check may query. Passed to `Check.run`; tests build it from `phm.testing`."""

    clock: Clock
    docker: DockerProbe
    files: FileProbe
    devices: DeviceProbe
    host: HostProbe
    ros: RosProbe
    links: LinkProbe
    swarm: SwarmProbe
    daemon: SelfProbe
    pressure: PressureProbe
    environment: EnvironmentProbe
    sockets: SocketProbe
    messages: MessageProbe
    serial: SerialProbe
    programs: ProgramProbe
    logs: LogProbe
