"""What a starvation made of an agent, read off its record, and the table of it. Pure."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from phm.wire.report import OK_LEVELS
from sitl.acceptance.table import grouped
from sitl.harness.log_follower import Event
from sitl.harness.log_queries import phase

BEGIN, END = (
    "<!-- starvation: begin, written by python -m sitl.bench.starvation --markdown -->",
    "<!-- starvation: end -->",
)
HEAD = ("fault", "alarms", "actions", "at the end")
OWN_REPAIRS = ("join_network", "reopen")
"""Actions that touch nothing but PHM itself."""


@dataclass
class Row:
    """One starvation. Seconds count from the moment the fault was there; None: it did not happen.

    expected: units at which an alarm is due, exactly one at each. alarms: ``unit (level)`` of every fault that was opened.
    beside: the same at `host/`, where not expected: true of the machine that all this runs on, and not judged.
    starts: of the application container, by the engine. left: what was not OK at the end, by PHM and by the engine.
    """

    fault: str
    title: str
    expected: list[str]
    healable: bool = False
    alarms: list[str] = field(default_factory=list)
    beside: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    blocked: list[str] = field(default_factory=list)
    actions: list[str] = field(default_factory=list)
    starts: int = 0
    detected_s: float | None = None
    recovered_s: float | None = None
    healthy_again_s: float | None = None
    left: list[str] = field(default_factory=list)
    sidecar_starts: int = 0
    problems: list[str] = field(default_factory=list)

    @property
    def good(self) -> bool:
        return not self.problems

    def read(self, events: Sequence[Event], moment: float, already: Collection[str] = ()) -> None:
        """Take alarms, actions and times from what PHM recorded since the injection began.

        already: units with a fault that was open before: on a busy machine `host/cpu` has its alarm when the overload comes.
        """
        self.alarms = [f"{unit} (open before)" for unit in self.expected if unit in already]
        warned, blocked = set(), set()
        for event in events:
            unit, after = event.get("unit", ""), event["mono"] - moment
            if event["event"] == "fault_opened":
                found = f"{unit} {event.get('condition') or '?'}"
                beside = unit.startswith("host/") and unit not in self.expected
                (self.beside if beside else self.alarms).append(found)
                if unit in self.expected[:1] and self.detected_s is None:
                    self.detected_s = after
            elif event["event"] == "transition" and event["level"] == "WARN":
                warned.add(unit)
            elif event["event"] == "transition" and event["level"] == "STALE" and event.get("blocked_by"):
                blocked.add(unit)
            elif event["event"] == "action" and event["phase"] == "started" and event["action"] not in OWN_REPAIRS:
                self.actions.append(event["action"])
            if unit in self.expected[:1] and phase("verified", unit, event):
                self.recovered_s = after if self.recovered_s is None else self.recovered_s
        self.warnings, self.blocked = sorted(warned), sorted(blocked)

    def judge(self) -> None:
        """What is not as it must be, in words."""
        units = [alarm.partition(" ")[0] for alarm in self.alarms]
        if sorted(units) != sorted(self.expected):
            self.problems.append(
                f"alarms at {count(units) or 'nothing'}, expected one at {' and '.join(self.expected)}"
            )
        if len(self.actions) > self.healable:
            self.problems.append(f"{len(self.actions)} actions, of which {int(self.healable)} can help")
        if self.healable and self.recovered_s is None:
            self.problems.append("was not recovered and verified")
        if self.left:
            self.problems.append(f"not OK at the end: {', '.join(self.left)}")
        if self.sidecar_starts:
            self.problems.append(f"PHM's container was started {self.sidecar_starts} times")


def levels(events: Iterable[Event]) -> Mapping[str, str]:
    """The level of every unit at the end of these events."""
    found: dict[str, str] = {}
    for event in events:
        if event["event"] == "start":
            found.clear()
        elif event["event"] in ("unit", "transition"):
            found[event["unit"]] = event["level"]
    return found


def not_ok(events: Iterable[Event]) -> list[str]:
    """Units that are not OK, and open faults, but those of the machine, which other programs may keep busy."""
    events = list(events)
    found = [f"{unit} {level}" for unit, level in levels(events).items() if level not in OK_LEVELS]
    found += [f"fault at {unit}" for unit in open_units(events)]
    return [each for each in found if "host/" not in each]


def open_units(events: Iterable[Event]) -> list[str]:
    """The units of the faults that are open at the end of these events."""
    found: dict[str, str] = {}
    for event in events:
        if event["event"] == "fault_opened":
            found[event["fault"]] = event["unit"]
        elif event["event"] == "fault_closed":
            found.pop(event["fault"], None)
    return list(found.values())


def count(words: Iterable[str]) -> str:
    """``a x2, b`` for a, b, a; the most frequent first."""
    found: dict[str, int] = {}
    for word in words:
        found[word] = found.get(word, 0) + 1
    ordered = sorted(found.items(), key=lambda entry: -entry[1])
    return ", ".join(word if number == 1 else f"{word} x{number}" for word, number in ordered)


def cells(row: Row) -> tuple[str, str, str]:
    """Alarms, actions and what is up at the end."""
    units = [alarm.partition(" ")[0] for alarm in row.alarms]
    alarms = f"{len(units)}: {count(units)}" if units else "none"
    seen = f" after {row.detected_s:.1f} s" if (row.detected_s or -1.0) > 0.0 and len(units) == 1 else ""
    acts = grouped(row.actions) or "none"
    recovered = f", recovered after {row.recovered_s:.1f} s" if row.recovered_s is not None else ""
    again = "" if row.healthy_again_s is None else f" {row.healthy_again_s:.0f} s after"
    return f"{alarms}{seen}", f"{acts}{recovered}", ", ".join(row.left) or f"all OK{again}"


def as_json(rows: Sequence[Row], where: str, what: str) -> str:
    found = {"machine": where, "what": what, "rows": [{**asdict(row), "good": row.good} for row in rows]}
    return json.dumps(found, indent=2)


def from_json(file: Path) -> tuple[str, list[Row]]:
    """What was measured on which machine, and the rows."""
    found = json.loads(file.read_text("utf-8"))
    rows = [Row(**{key: value for key, value in each.items() if key != "good"}) for each in found["rows"]]
    return f"{found['what']} ({found['machine']})", rows


def markdown(measured: Sequence[tuple[str, Sequence[Row]]]) -> str:
    """One line for each fault and measurement; `measured` are (words, rows)."""
    lines = [f"| {' | '.join((HEAD[0], 'code', *HEAD[1:]))} |", f"|{'---|' * (len(HEAD) + 1)}"]
    names = list(dict.fromkeys(row.fault for _, rows in measured for row in rows))
    for name in names:
        for words, rows in measured:
            for row in (row for row in rows if row.fault == name):
                end = cells(row)[2] if row.good else f"{cells(row)[2]}; **does not hold**"
                lines.append(f"| {row.title} | {words} | {' | '.join((*cells(row)[:2], end))} |")
    return "\n".join(lines)
