"""Run ``python -m sitl.bench``: the figures of one agent. The other benches are modules of this package."""

import sys

from sitl.bench.agent import main

sys.exit(main())
