"""Rows of `sitl.bench.ros_environments`: which environments are measured, and the table of what was found. Pure."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

BEGIN, END = (
    "<!-- environments: begin, written by python -m sitl.bench.ros_environments --markdown -->",
    "<!-- environments: end -->",
)
NETWORKS = {"bridge": "bridge network", "host": "host network"}
PROFILES = {"none": "no profile", "shipped": "fastdds.xml"}
DISTROS = {"jazzy": "Jazzy", "kilted": "Kilted"}
_LOCAL = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
PORT = 11811


@dataclass(frozen=True)
class Discovery:
    """How application and PHM are to find each other; `{app}` and `{phm}` in values are their addresses."""

    title: str
    app: Mapping[str, str] = field(default_factory=dict)
    phm: Mapping[str, str] = field(default_factory=dict)
    shared_ipc: bool = False
    multicast: bool = True
    server: bool = False


_SERVER = {"ROS_DISCOVERY_SERVER": f"{{app}}:{PORT}"}
DISCOVERIES = {
    "default": Discovery("default range"),
    "local_shared": Discovery("`LOCALHOST`, shared IPC", _LOCAL, _LOCAL, shared_ipc=True),
    "local": Discovery("`LOCALHOST`, separate IPC", _LOCAL, _LOCAL),
    "local_memory": Discovery(
        "`LOCALHOST`, separate IPC, `FASTDDS_BUILTIN_TRANSPORTS=DEFAULT` in PHM",
        _LOCAL,
        {**_LOCAL, "FASTDDS_BUILTIN_TRANSPORTS": "DEFAULT"},
    ),
    "local_app": Discovery("`LOCALHOST` in the application alone", _LOCAL),
    "local_phm": Discovery("`LOCALHOST` in PHM alone", {}, _LOCAL),
    "local_peer": Discovery(
        "`LOCALHOST` in the application, its address in PHM's `ROS_STATIC_PEERS`", _LOCAL, {"ROS_STATIC_PEERS": "{app}"}
    ),
    "peers": Discovery(
        "static peers on both sides, multicast blocked",
        {"ROS_STATIC_PEERS": "{phm}"},
        {"ROS_STATIC_PEERS": "{app}"},
        multicast=False,
    ),
    "server": Discovery("Fast DDS discovery server, multicast blocked", _SERVER, _SERVER, multicast=False, server=True),
}


@dataclass(frozen=True)
class Case:
    """One row to measure; keys of the tables above."""

    network: str
    discovery: str
    profile: str
    distro: str

    @property
    def name(self) -> str:
        return f"{self.network}/{self.discovery}/{self.profile}/{self.distro}"


@dataclass
class Row:
    """What PHM made of one case: how many nodes and rates were OK, after which time, and when a killed node was reported.

    reported: the unit with the first fault after the kill. conditions: of the faults, where something was not seen.
    """

    case: Case
    nodes: int = 0
    rates: int = 0
    of: int = 0
    seen_s: float | None = None
    killed_s: float | None = None
    reported: str = ""
    conditions: list[str] = field(default_factory=list)

    @property
    def seen(self) -> bool:
        return self.of > 0 and self.nodes == self.of

    @property
    def cell(self) -> str:
        """Nodes, data and the time of the report, in a few words."""
        if not self.nodes and not self.rates:
            return "**no**"
        data = "" if self.rates == self.of else f", data of {self.rates}"
        found = "yes" if self.seen else f"{self.nodes} of {self.of} nodes"
        killed = f", {self.killed_s:.1f} s" if self.killed_s is not None else ", killed node not reported"
        return f"{found}{data}{killed if self.seen else ''}"


def cases(only: Sequence[str] = ()) -> Iterator[Case]:
    """All cases, or those whose name contains one of the words."""
    for distro in DISTROS:
        for network in NETWORKS:
            for discovery in DISCOVERIES:
                for profile in PROFILES:
                    case = Case(network, discovery, profile, distro)
                    if not only or any(word in case.name for word in only):
                        yield case


def as_json(rows: Sequence[Row], machine: str) -> str:
    return json.dumps({"machine": machine, "rows": [asdict(row) for row in rows]}, indent=2)


def from_json(file: Path) -> tuple[str, list[Row]]:
    """The machine, and the rows."""
    found = json.loads(file.read_text("utf-8"))
    return found["machine"], [Row(Case(**row.pop("case")), **row) for row in found["rows"]]


def markdown(rows: Sequence[Row]) -> str:
    """One line for each network and way of discovery, one column for each distribution and profile."""
    columns = [(distro, profile) for distro in DISTROS for profile in PROFILES]
    head = [f"{DISTROS[distro]}, {PROFILES[profile]}" for distro, profile in columns]
    lines = [f"| network | discovery | {' | '.join(head)} |", f"|{'---|' * (len(head) + 2)}"]
    found = {row.case: row for row in rows}
    for network, network_title in NETWORKS.items():
        for discovery, how in DISCOVERIES.items():
            kept = [found.get(Case(network, discovery, profile, distro)) for distro, profile in columns]
            if any(kept):
                cells = [row.cell if row is not None else "" for row in kept]
                lines.append(f"| {network_title} | {how.title} | {' | '.join(cells)} |")
    return "\n".join(lines)
