"""Where histories are kept if no file is named."""

from __future__ import annotations

import os
import sys
from pathlib import Path

STATE_DIR = Path("/var/lib/phm")
"""The default of `state_dir`."""


def default_path() -> Path:
    """The default file: in the state folder of the user."""
    return _user_folder() / "gcs-history.db"


def agent_path(state_dir: Path = STATE_DIR) -> Path:
    """The default file of an agent's own page: in the state folder of PHM if that belongs to this user, as in a container, else in that
    of the user."""
    return (state_dir if _is_mine(state_dir) else _user_folder()) / "page-history.db"


def _is_mine(folder: Path) -> bool:
    if sys.platform == "win32":
        return False
    try:
        return folder.stat().st_uid == os.geteuid()
    except OSError:
        return False


def _user_folder() -> Path:
    base = os.environ.get("XDG_STATE_HOME") or os.path.join(os.path.expanduser("~"), ".local", "state")
    return Path(base) / "phm"
