"""What nodes write about their reception, as others read it."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from sitl.application.received import FOLDER
from sitl.faults._application import container_works


def test_a_record_that_two_nodes_write_is_none(tmp_path: Path) -> None:
    """Two nodes of one name write the same file at the same time: the application is not seen to work, and nothing fails."""
    folder = tmp_path / str(os.getpid()) / "root" / FOLDER.relative_to("/")
    folder.mkdir(parents=True)
    state = {"Running": True, "Paused": False, "Pid": os.getpid()}
    app: Any = SimpleNamespace(attrs={"State": state, "Config": {"Cmd": ["python", "-m", "sitl.application.app"]}})
    record = json.dumps({"at": time.monotonic(), "topics": {}})
    for node in ("node_1", "node_2", "node_3"):
        (folder / f"{node}.json").write_text(record + "}", "ascii")
    assert not container_works(app, tmp_path)
