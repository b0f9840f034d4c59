"""Run ``python -m sitl``: a simulated swarm on this machine. See docs/development/sitl.md."""

from __future__ import annotations

import sys

from sitl.campaign.main import main as campaign
from sitl.swarm.cli import main as swarm

if __name__ == "__main__":
    sys.exit(campaign(sys.argv[2:]) if sys.argv[1:2] == ["campaign"] else swarm())
