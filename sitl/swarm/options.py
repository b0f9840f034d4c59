"""What a swarm is made of: chosen once with `up`, kept beside the swarm in `swarm.json`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

DEFAULT_NAME = "phm-swarm"
MOST_AGENTS = 24
"""Docker's default address pools hold 31 networks, and each agent has one."""
Autopilot = Literal["sim", "ardupilot", "px4"]
ProfileName = Literal["tuned", "shipped", "as-found"]
PROFILES: tuple[ProfileName, ...] = ("tuned", "shipped", "as-found")


@dataclass(frozen=True)
class Options:
    """interval_s: PHM's. nodes, rate_hz: the application's ring, each node publishing one topic. graph: instead of the
    ring, a file in YAML (docs/development/sitl.md). changes: lines of the shipped configuration to be replaced, for `sitl.harness.config_overrides`.
    mode: `recovery.mode`. autopilot_path, autopilot_image, autopilot_command: where a real autopilot comes
    from and how it is started, see `sitl.swarm.external_autopilots`. profile: ``shipped`` sets only those keys of PHM's
    configuration that say what there is; ``tuned`` also requires the radio; ``as-found`` is ``shipped`` beside an
    application that knows nothing of PHM: no beacon, no discovery profile, a HEALTHCHECK every 30 s, and command lines
    without the names of nodes."""

    agents: int = 8
    name: str = DEFAULT_NAME
    interval_s: float = 20.0
    nodes: int = 3
    rate_hz: float = 5.0
    graph: str = ""
    mode: str = "act"
    autopilot: Autopilot = "sim"
    autopilot_path: str = ""
    autopilot_image: str = ""
    autopilot_command: str = ""
    seed: int = 0
    build: bool = True
    """Whether `scripts/image` is run first, which does nothing when the images are up to date."""
    changes: Mapping[str, str] = field(default_factory=dict)
    profile: ProfileName = "tuned"

    def write(self, file: Path) -> None:
        file.write_text(json.dumps(asdict(self), indent=2) + "\n", "utf-8")

    @classmethod
    def read(cls, text: Mapping[str, Any]) -> Options:
        return cls(**text)
