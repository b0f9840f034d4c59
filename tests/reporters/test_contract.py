"""`docs/reference/logs.md` is a contract: it names exactly the keys that are written."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import phm
from phm.core.model import ActionEvent, HoldChanged, Level, Note, Outcome, Phase, Report, ReportStarted, Slot
from phm.core.settings import LogSettings, Settings
from phm.reporters.base import MavlinkSender
from phm.reporters.log import LogReporter
from phm.reporters.received_heartbeats import WRITE_S
from phm.reporters.rotating_file import FIRST_RETRY_S, RING_LINES
from phm.reporters.text_log_format import NOTE_KINDS
from phm.testing import FakeClock
from phm.wire import json_log
from tests.fakes.records import at, closed, context, opened, transition, unit

DOCUMENT = Path(phm.__file__).parents[1] / "docs" / "reference" / "logs.md"
UNIT = unit("nodes/a", Slot.NODES, Level.ERROR)


def documented() -> dict[str, set[str]]:
    """Keys by event, from the tables of the document; the keys of every line under `every`."""
    keys: dict[str, set[str]] = {}
    for section in DOCUMENT.read_text().split("\n### ")[1:]:
        title = section.partition("\n")[0]
        name = "every" if title == "Keys of every line" else title.split("`")[1]
        keys[name] = set(re.findall(r"^\| `(\w+)` \|", section.partition("\n## ")[0], re.MULTILINE))
    return keys


def written(directory: Path) -> dict[str, set[str]]:
    """Keys by event of a log that contains every event."""
    clock = FakeClock()
    (directory / "logs").write_text("in the way")
    settings = Settings(log=LogSettings(directory=str(directory / "logs")), state_dir=str(directory / "state"))
    listeners: list[Any] = []
    links = cast(MavlinkSender, SimpleNamespace(listen=lambda callback, ids: listeners.append(callback)))
    log = LogReporter.build(replace(context(settings, clock=clock), reported_armed=lambda: True, mavlink=links))
    for _ in range(RING_LINES):
        log.handle(Note(at(), "PHM", "x"))
    (directory / "logs").unlink()
    clock.advance(FIRST_RETRY_S)
    act = ActionEvent(at(), "f", UNIT.unit, "restart", "ros_app", Phase.STARTED)
    end = closed(UNIT, Outcome.RESOLVED, "restart", 1.0)
    hold = HoldChanged(at(), "ros_app", True, "operator", "why", 600.0, "ros_app is on hold")
    report = Report(at(), 1, at(), (UNIT,))
    for event in (ReportStarted(at(), 1), transition(UNIT), opened(UNIT), act, end, hold, report):
        log.handle(event)
    frame = SimpleNamespace(get_srcSystem=lambda: 255, get_srcComponent=lambda: 190, get_seq=lambda: 8)
    listeners[0](frame, "ground")
    clock.advance(WRITE_S)
    log.tick()
    log.close()
    LogReporter.build(context(Settings(log=LogSettings(directory=str(directory / "logs"))))).close()
    return {str(line["event"]): set(line) for line in json_log.read(directory / "logs")}


def test_exactly_the_written_keys_are_documented(tmp_path: Path) -> None:
    """Each event has its section with exactly its keys; the common keys are in each line."""
    wanted = documented()
    every = wanted.pop("every") - {"cut"}
    assert written(tmp_path) == {event: keys | every for event, keys in wanted.items()}


def test_every_kind_is_documented() -> None:
    """The kinds of the text log are in the table of kinds."""
    table = set(re.findall(r"^\| ([A-Z]+) \|", DOCUMENT.read_text(), re.MULTILINE))
    assert table >= {*NOTE_KINDS, "SUCCESS", "BYPASS", "WARNING", "FAILURE", "STALE", "RESOLVED", "ESCALATED"}
