"""One report in the forms in which it could be sent, weighed: PHM's status line, JSON, and diagnostic_msgs/DiagnosticArray."""

from __future__ import annotations

import json
import subprocess
import sys
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from functools import lru_cache
from pathlib import Path

from phm.core.clock import SystemClock
from phm.core.model import Layer, Level, Result, Slot, Stamp, UnitState
from phm.facts.ros import DIAGNOSTICS, DiagnosticFact
from phm.reporters.base import ReporterContext
from phm.reporters.diagnostics import DiagnosticsReporter
from phm.runtime.sections import reporter_settings
from phm.testing import settings
from phm.transport.dialect import mavlink
from phm.transport.mavlink_codec import Codec
from phm.wire.report import OK_LEVELS, report_json
from phm.wire.status_line import Severity, refresh

FORMS = ("json", "deflated", "diagnostics")
CHILD_S = 60.0


@dataclass(frozen=True)
class Size:
    """Bytes of one report. deflated: of `json`, by zlib at its best; diagnostics: CDR, None where ROS is not installed."""

    mavlink: int
    json: int
    deflated: int
    diagnostics: int | None


def load(path: Path) -> tuple[UnitState, ...]:
    """The units of a report, as `phm once --json` and `phm status --json` print it. Raises OSError, ValueError, KeyError."""
    document = json.loads(path.read_text("utf-8"))
    if not isinstance(document, dict) or not document.get("checks"):
        raise ValueError(f"{path} has no 'checks'")
    return tuple(map(_unit, document["checks"]))


def sizes(units: Sequence[UnitState]) -> Size:
    """Of the report that these units make."""
    text = mavlink.MAVLink_statustext_message(int(Severity.INFO), refresh(1, units).encode("ascii"))
    packed = json.dumps(report_json("agent_1", units), separators=(",", ":")).encode()
    line = Codec(1, 193, lambda _: True).size(text)
    return Size(line, len(packed), len(zlib.compress(packed, 9)), _cdr(json.dumps(_diagnostics(units))))


def _unit(entry: Mapping[str, object]) -> UnitState:
    """The other way round of `phm.wire.report.unit_json`."""
    text = {
        key: str(entry[key])
        for key in ("id", "check", "summary", "brief", "condition", "target", "blocked_by", "fault")
    }
    since = datetime.strptime(str(entry["since"]), "%Y-%m-%dT%H:%M:%S.%f%z").timestamp()
    values = entry["values"]
    if not isinstance(values, dict):
        raise ValueError(f"'values' of {text['id']} is not an object")
    result = Result(
        Level.OK if entry["level"] in OK_LEVELS else Level[str(entry["level"])],
        text["summary"],
        text["brief"],
        text["condition"],
        text["target"],
        values,
        bool(entry["bypass"]),
    )
    return UnitState(
        text["id"],
        text["check"],
        Slot(int(str(entry["slot"]))),
        Layer(str(entry["layer"])),
        result.level,
        result,
        Stamp(since, 0.0),
        text["blocked_by"],
        text["fault"],
        float(str(entry["duration_ms"])) / 1000,
    )


class _Pipe:
    """Takes what goes to the ROS child."""

    def __init__(self) -> None:
        self.statuses: Mapping[str, DiagnosticFact] = {}

    def idle(self, topic: str = DIAGNOSTICS) -> bool:
        return False

    def publish(self, statuses: Mapping[str, DiagnosticFact], topic: str = DIAGNOSTICS) -> int:
        self.statuses = statuses
        return 0


def _diagnostics(units: Sequence[UnitState]) -> dict[str, object]:
    """What PHM's own reporter would have published."""
    pipe = _Pipe()
    context = ReporterContext(
        reporter_settings(settings(agent={"name": "agent_1"})),
        SystemClock(),
        "boot",
        lambda: tuple(units),
        lambda: True,
        dict,
        None,
    )
    DiagnosticsReporter(context, pipe).tick()
    return {name: asdict(fact) for name, fact in pipe.statuses.items()}


@lru_cache(maxsize=16)
def _cdr(statuses: str) -> int | None:
    """Bytes that ROS serializes them to, asked of a process that has ROS."""
    done = subprocess.run(
        (sys.executable, "-m", "sitl.bench.cdr_size"),
        input=statuses,
        capture_output=True,
        text=True,
        timeout=CHILD_S,
        check=False,
        cwd=Path(__file__).resolve().parents[2],
    )
    if done.returncode:
        raise RuntimeError(f"the DiagnosticArray could not be weighed: {done.stderr.strip()[-500:]}")
    return int(done.stdout) if done.stdout.strip() else None
