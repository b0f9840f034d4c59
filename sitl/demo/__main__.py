"""Run ``python -m sitl.demo``."""

import sys

from sitl.demo.main import main

sys.exit(main())
