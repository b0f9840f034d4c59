"""Turn check results into transitions and faults: thresholds, grace, root cause. Pure; the caller passes the time.

`rules` decides about one unit's latest result and changes nothing; `tracker` applies the decisions; `faults` opens and
closes faults; `units` has the shared records; `starvation` decides which symptoms a resource shortage explains; `start_dedup`
counts each container start once.
"""

from phm.tracker.tracker import Tracker
from phm.tracker.units import Effects, TrackedUnit, all_needs, graph_of

__all__ = ["Effects", "TrackedUnit", "Tracker", "all_needs", "graph_of"]
