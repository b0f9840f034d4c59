"""``python -m sitl``: a simulated swarm on this machine. See docs/development/sitl.md."""

from __future__ import annotations

import sys

from sitl.swarm.cli import main

if __name__ == "__main__":
    sys.exit(main())
