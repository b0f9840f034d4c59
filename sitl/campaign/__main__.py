"""Run ``python -m sitl.campaign``."""

import sys

from sitl.campaign.main import main

sys.exit(main())
