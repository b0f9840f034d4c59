"""Run ``python -m sitl.soak``."""

from __future__ import annotations

import sys

from sitl.soak.main import main

if __name__ == "__main__":
    sys.exit(main())
