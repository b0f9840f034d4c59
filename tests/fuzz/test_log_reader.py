"""The log and the status file on a ground computer: truncated, foreign and hostile lines."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

from click.testing import CliRunner
from hypothesis import strategies as st

from phm.cli import group
from phm.wire import fault_timeline, json_log
from tests.fuzz.hostile import messages
from tests.fuzz.targets import fuzzed

OPENED = {
    "v": 1,
    "event": "fault_opened",
    "utc": "2026-11-21T10:00:00.000Z",
    "fault": "ab12-1",
    "unit": "container/app",
    "slot": 2,
    "layer": "docker",
    "condition": "exited",
    "summary": "app exited",
    "brief": "app exited",
    "target": "app",
    "opened": "2026-11-21T10:00:00.000Z",
    "consequences": ["ab12-2"],
    "suspects": ["memory"],
}
EVENTS: list[dict[str, Any]] = [
    OPENED,
    {
        **OPENED,
        "event": "fault_closed",
        "outcome": "resolved",
        "by": "start",
        "closed": OPENED["utc"],
        "duration_s": 1.5,
        "blocks": ["nodes/a"],
    },
    {
        "v": 1,
        "event": "action",
        "utc": OPENED["utc"],
        "fault": "ab12-1",
        "action": "start",
        "phase": "started",
        "target": "app",
        "detail": "words",
    },
    {"v": 1, "event": "transition", "utc": OPENED["utc"], "unit": "nodes/a", "blocked_by": "container/app"},
]
LINES = st.sampled_from(EVENTS).flatmap(messages) | st.sampled_from(EVENTS).map(
    lambda event: json.dumps(event).encode()
)


@fuzzed("log reader", lines=st.lists(LINES, max_size=8))
def test_any_log_is_read(lines: list[bytes]) -> None:
    """Each line that is an object is an event, faults can be printed as text and as strict JSON, and nothing raises."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "phm.jsonl").write_bytes(b"\n".join(lines))
        events = list(json_log.read(folder))
        assert all(isinstance(event, dict) for event in events)
        for open_now in (None, [], [event for event in events if event.get("event") == "fault_opened"]):
            found = fault_timeline.build_timelines(events, open_now)
            json.dumps(found, allow_nan=False)
        runner = CliRunner()
        names = [str(found[0]["fault"])] if found else []
        for more in ([], ["--json"], ["--all"], ["--", *names]):
            result = runner.invoke(group, ["faults", "--log-dir", folder, "--run-dir", folder, *more])
            assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
            assert "\x1b" not in result.output
