"""From results to transitions and faults: thresholds, warm-up, root cause. Pure; the caller brings time.

`rules` judges one unit's newest result and changes nothing; `tracker` keeps what follows from it; `episodes` opens
and closes faults; `units` holds the records that they share.
"""

from phm.tracker.rules import GRACE_ENDS_AFTER_OK_S
from phm.tracker.tracker import Tracker
from phm.tracker.units import Effects, TrackedUnit, all_needs, graph_of

__all__ = ["GRACE_ENDS_AFTER_OK_S", "Effects", "TrackedUnit", "Tracker", "all_needs", "graph_of"]
