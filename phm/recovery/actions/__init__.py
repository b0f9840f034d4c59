"""The actions that come with PHM, one file each; found through the entry points of `phm.actions`, like anyone's."""

from __future__ import annotations

from phm.recovery.actions.join import Join, join
from phm.recovery.actions.reconnect import Reconnect
from phm.recovery.actions.relaunch import Relaunch
from phm.recovery.actions.restart import Restart
from phm.recovery.actions.restore import Restore
from phm.recovery.actions.start import Start
from phm.recovery.actions.unpause import Unpause

__all__ = ["Join", "Reconnect", "Relaunch", "Restart", "Restore", "Start", "Unpause", "join"]
