"""Close a MAVLink endpoint and open it again."""

from __future__ import annotations

from phm.model import Fault
from phm.recovery.base import Action, ActionContext, ActionFailed
from phm.recovery.links import name_of
from phm.settings import ContainerSettings

OPEN_S = 8.0
"""A connection is given up after 5 s."""


class Reopen(Action):
    """Close a MAVLink endpoint of PHM's own that is open and silent, and open it again: a port whose driver is stuck, a
    connection that only one side believes in. A serial port keeps its DTR up meanwhile, so nothing behind it is reset."""

    name = "reopen"
    on_myself = True
    deadline_s = OPEN_S + 4.0

    def run(self, target: ContainerSettings, fault: Fault, context: ActionContext) -> str:
        link = name_of(target.key)
        if not link:
            raise ActionFailed(
                f"reopen is for MAVLink endpoints, and {target.key} is a container: correct recovery.ladders"
            )
        if not context.reopen(link, OPEN_S):
            raise ActionFailed(
                f"the MAVLink endpoint {link} did not open again within {OPEN_S:g} s; PHM goes on trying"
            )
        return f"reopened the MAVLink endpoint {link}"
