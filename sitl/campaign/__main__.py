"""``python -m sitl.campaign`` is ``python -m sitl campaign``."""

import sys

from sitl.campaign.main import main

sys.exit(main())
