"""Run ``python -m sitl.acceptance``."""

import sys

from sitl.acceptance.main import main

sys.exit(main())
