"""Records of one run of PHM, written line by line: for more lines than the log reporter writes in the time of a test."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tests.review.records import T0

LINE = {"v": 2, "agent": "agent_1", "agent_id": 1, "boot_id": "b", "kind": "PHM"}


def write(folder: Path, events: Iterable[dict[str, Any]]) -> Path:
    """Each event with `at`, its seconds since T0; they are numbered."""
    folder.mkdir(exist_ok=True)
    with (folder / "phm.jsonl").open("w") as file:
        for seq, event in enumerate(events, 1):
            at = event["at"]
            body = {key: value for key, value in event.items() if key != "at"}
            file.write(json.dumps({**LINE, "seq": seq, "mono": 50.0 + at, "utc_s": T0 + at, **body}) + "\n")
    return folder


def unit(at: float, name: str, level: str = "OK", /, **values: Any) -> dict[str, Any]:
    """The line of a unit in a report."""
    check = name.partition("/")[0]
    return {"event": "unit", "unit": name, "check": check, "layer": "ros", "level": level, "values": values, "at": at}


def change(at: float, name: str, old: str, level: str, **more: Any) -> dict[str, Any]:
    return {**unit(at, name, level), "event": "transition", "old": old, "summary": f"{name} {level}", **more}
