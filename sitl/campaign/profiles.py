"""The profiles of a campaign: how much is configured for it, in PHM and in the application."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import cast

from docker import DockerClient

from sitl.campaign.differences import of_configuration
from sitl.faults.base import Agent, Fault
from sitl.faults.file_deleted import CONTENT
from sitl.harness.config_overrides import overridden
from sitl.swarm.options import PROFILES, ProfileName

CHANGES = {
    "\n  budget: 5": "\n  budget: 100",
    '#sha256: "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855"': f'sha256: "{hashlib.sha256(CONTENT).hexdigest()}"',
    "#restore: image": "restore: image",
    "\n    ground: respect": "\n    ground: heal",
}
"""Of the profile *tuned*: room for many faults in a row, a file that can be judged and restored, and a pause that counts as a failure
although the vehicle is disarmed."""
NAMING = re.compile(
    r"agent\.\w+"
    r"|containers\[[^]]*\]\.(name|alias|label|recover)"
    r"|ros\.nodes\[[^]]*\]\.(name|container)"
    r"|ros\.topics\[[^]]*\]\.(name|type|rate|publishers|subscribers|container)"
    r"|mavlink\.endpoints\[[^]]*\]\.(url|name|leads_to|container)|mavlink\.autopilot|swarm\.agents"
    r"|docker\.socket|host\.disks|log\.directory|state_dir"
)
"""Keys that say what there is and where, so every user has to set them."""


@dataclass(frozen=True)
class Profile:
    """changes: of the shipped configuration of all agents. unseen: faults that its configuration cannot detect or does not report, and
    why. not_recovered: faults that PHM may only report. seen_limit_s: a fault that was not reported for this long after
    its first evidence is missed. recovered_limit_s: how long a recovery may take after the first evidence. actions: most
    actions of PHM on an agent within `recovery.window` before its next fault; None: any number.
    """

    name: ProfileName
    changes: Mapping[str, str] = field(default_factory=dict)
    unseen: Mapping[str, str] = field(default_factory=dict)
    not_recovered: frozenset[str] = frozenset()
    seen_limit_s: float = 30.0
    recovered_limit_s: float = 90.0
    actions: int | None = None

    @property
    def tuned(self) -> bool:
        return self.name == "tuned"


_UNSEEN = {
    "container_paused": "the shipped configuration respects a pause while the vehicle is disarmed",
    "file_altered": "the shipped configuration does not have the SHA-256 of the file",
}
_NOT_RECOVERED = frozenset({"file_deleted", "file_not_executable"})
"""The shipped configuration does not allow PHM to restore files."""
_OF_FIVE = 2
"""The shipped budget is five actions in ten minutes. A campaign injects more often than faults occur, so it waits until at
least three are left.
"""
ALL: Mapping[str, Profile] = {
    "tuned": Profile("tuned", CHANGES),
    "shipped": Profile("shipped", {}, _UNSEEN, _NOT_RECOVERED, actions=_OF_FIVE),
    # Docker runs the HEALTHCHECK every 30 s: up to 30 s pass before a failure, and again before a success.
    "as-found": Profile(
        "as-found", {}, _UNSEEN, _NOT_RECOVERED, seen_limit_s=45.0, recovered_limit_s=150.0, actions=_OF_FIVE
    ),
}
assert tuple(ALL) == PROFILES


def beyond_naming(fault: Fault) -> list[str]:
    """The keys with which PHM must be configured to see or recover the fault, other than those that name things."""
    if "configuration" not in fault.needs:
        return []
    agent = Agent("phm-swarm-1", "agent_1", docker=cast(DockerClient, None))
    found = of_configuration(overridden(fault.configuration(agent)), {"PHM_AGENT": "agent_1"})
    return [each["key"] for each in found if not NAMING.fullmatch(each["key"])]
