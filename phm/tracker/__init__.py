"""From results to transitions and faults: thresholds, warm-up, root cause. Pure; the caller brings time.

`rules` judges one unit's newest result and changes nothing; `tracker` keeps what follows from it; `episodes` opens
and closes faults; `units` holds the records that they share.
"""

from phm.tracker.rules import SURE_S
from phm.tracker.tracker import Tracker
from phm.tracker.units import Step, Tracked, all_needs

__all__ = ["SURE_S", "Step", "Tracked", "Tracker", "all_needs"]
