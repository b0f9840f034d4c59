"""Tables from the same JSON that `--json` prints, for `phm once`, `phm status`, `phm faults` and `phm checks`.

Levels are words as well as colours; with NO_COLOR, or when the output is not a terminal, words only.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from phm.wire.report import NOT_APPLICABLE, with_hertz
from phm.wire.text import one_line

Json = Mapping[str, Any]

_STYLES = {"OK": "green", "WARN": "yellow", "ERROR": "bold red", "STALE": "magenta", NOT_APPLICABLE: "dim"}
_PIPE_WIDTH = 160
"""Columns when the output is not a terminal: wide enough for most summaries."""
LATE_PERCENT = 2.0
"""Less is normal and not shown."""


def report(document: Json) -> None:
    """What `phm once` prints of a report (`phm.wire.report.report_json`)."""
    console().print(Group(_units(document["checks"]), _array(document)))


def status(document: Json, problem: str) -> None:
    """What `phm status` prints of the status file; problem: why the daemon is not healthy, else empty."""
    console().print(_status(document, problem))


def watch(read: Callable[[], tuple[Json, str]]) -> None:
    """Show the status every second until interrupted: in place on a terminal, else one after another."""
    target = console()
    if not target.is_terminal:
        while True:
            target.print(_seen(*read()))
            time.sleep(1)
    with Live(_seen(*read()), console=target, screen=True, auto_refresh=False) as live:
        while True:
            time.sleep(1)
            live.update(_seen(*read()), refresh=True)


def checks(rows: Sequence[Json]) -> None:
    """What `phm checks` prints; rows as in its JSON."""
    table = _table("slot", "check", "layer", "from", "description")
    for row in rows:
        said = Text(f"not usable: {row['problem']}", "bold red") if row["problem"] else _plain(row["description"])
        slot = "-" if row["slot"] is None else str(row["slot"])
        table.add_row(slot, _plain(row["name"]), row["layer"] or "-", _plain(row["source"]), said)
    console().print(table)


def doctor(rows: Sequence[tuple[str, str, str, str, str]], styles: Mapping[str, str]) -> None:
    """What `phm doctor` prints: group, name, state, text and remedy of each row; styles by state."""
    table = _table("group", "what", "state", "result")
    for group, name, state, text, remedy in rows:
        result = _plain(text)
        if remedy:
            result.append("\n" + one_line(f"-> {remedy}"), "bold")
        table.add_row(_plain(group), _plain(name), _plain(state, styles.get(state, "")), result)
    console().print(table)


def faults(episodes: Sequence[Json], running: bool) -> None:
    """What `phm faults` prints: one row per fault, open ones last."""
    target = console()
    if not episodes:
        target.print(Text("No faults.", "green"))
    else:
        table = _table("fault", "unit", "since", "outcome", "what")
        for episode in sorted(episodes, key=lambda episode: (episode["outcome"] == "open", episode["current"])):
            what = _plain(episode["summary"] or "")
            if episode["blocks"]:
                what.append("\n" + one_line(f"blocks {', '.join(episode['blocks'])}"))
            steps = [
                step for step in episode["timeline"] if step["what"].endswith((" advised", " approved", " expired"))
            ]
            if steps and episode["outcome"] == "open":
                what.append("\n" + one_line(steps[-1]["text"]))
            name, unit, since = (_plain(episode[key] or "-") for key in ("fault", "unit", "opened"))
            table.add_row(name, unit, since, _outcome(episode), what)
        target.print(table)
    _warn_unless(running, target)


def timeline(episode: Json, running: bool) -> None:
    """What `phm faults FAULT` prints: its timeline."""
    target = console()
    head = _plain(f"{episode['fault']}  {episode['unit']}  ", "bold")
    target.print(head.append_text(_outcome(episode)))
    table = _table("utc", "step", "what")
    for step in episode["timeline"]:
        table.add_row(_plain(step["utc"] or "-"), _plain(step["what"]), _plain(step["text"]))
    target.print(table)
    _warn_unless(running, target)


def _warn_unless(running: bool, target: Console) -> None:
    if not running:
        target.print(Text("PHM is not running; this is from its log.", "yellow"))


def _outcome(episode: Json) -> Text:
    outcome = str(episode["outcome"])
    style = {"open": "bold red", "escalated": "red", "resolved": "green"}.get(outcome, "magenta")
    by = f" by {episode['by']}" if episode["by"] and outcome == "resolved" else ""
    took = f" in {episode['duration_s']} s" if isinstance(episode["duration_s"], (int, float)) else ""
    if outcome == "escalated" and episode["current"]:
        return _plain("given up, not resolved", "bold red")
    return _plain(f"{outcome}{by}{took}", style)


def console() -> Console:
    """Standard output, never wider than the terminal."""
    plain = Console(highlight=False, markup=False, emoji=False)
    if plain.is_terminal or "COLUMNS" in os.environ:
        return plain
    return Console(highlight=False, markup=False, emoji=False, width=_PIPE_WIDTH)


def _seen(document: Json, problem: str) -> RenderableType:
    return _status(document, problem) if document else Text(problem, "bold red")


def _status(document: Json, problem: str) -> RenderableType:
    parts: list[RenderableType] = [_head(document)]
    if problem:
        parts.append(Text(f"{problem} The following is out of date.", "bold red"))
    parts += [_plain(_hold(hold), "cyan") for hold in document.get("holds", ())]
    faults = document.get("faults", {})
    parts.append(_faults(faults.get("open", ()), faults.get("given_up", ()), faults.get("closed", ())))
    parts += [_units(document.get("checks", ())), _array(document)]
    parts += _health(document.get("health", {}))
    return Group(*parts)


def _head(document: Json) -> Text:
    word = document.get("status_word")
    line = f"{document.get('agent')} (agent {document.get('agent_id')}), PHM {document.get('version')}"
    uptime_s = document.get("health", {}).get("uptime_s")
    line += f", up {_duration(uptime_s)}" if isinstance(uptime_s, (int, float)) else ""
    line += f", written {document.get('written_utc')}"
    line += f", status word 0x{word:08X}" if isinstance(word, int) else ""
    return _plain(line, "bold")


def _hold(hold: Json) -> str:
    reason = f": {hold['reason']}" if hold["reason"] else ""
    until = str(hold["until"])[11:19]
    what = hold["container"] or "every container"
    return f"on hold: {what} until {until} UTC ({_duration(hold['left_s'])} left) by {hold['by']}{reason}"


def _faults(opened: Sequence[Json], given_up: Sequence[Json], closed: Sequence[Json]) -> RenderableType:
    if not opened and not given_up and not closed:
        return Text("No faults.", "green")
    table = _table("fault", "unit", "since", "outcome", "what")
    for fault, outcome in [*((one, "open") for one in opened), *((one, "given up") for one in given_up)]:
        what = _plain(fault["summary"])
        if fault["blocks"]:
            what.append("\n" + one_line(f"blocks {', '.join(fault['blocks'])}"))
        name, unit, since = (_plain(fault[key]) for key in ("fault", "unit", "opened"))
        table.add_row(name, unit, since, Text(outcome, "bold red"), what)
    names = {fault["fault"] for fault in given_up}
    for fault in reversed([fault for fault in closed if fault["fault"] not in names][-5:]):
        outcome = f"{fault['outcome']}{' by ' + fault['by'] if fault['by'] else ''} in {fault['duration_s']} s"
        shown = _plain(outcome, "red" if fault["outcome"] == "escalated" else "green")
        name, unit, since = (_plain(fault[key]) for key in ("fault", "unit", "opened"))
        table.add_row(name, unit, since, shown, _plain(fault["brief"]))
    return table


def _units(rows: Iterable[Json]) -> Table:
    table = _table("slot", "unit", "level", "what")
    for row in sorted(rows, key=lambda row: int(row["slot"])):
        level = str(row["level"])
        cause, what = f"blocked by {row['blocked_by']}", with_hertz(row, str(row["summary"]))
        if row["blocked_by"] and not what.startswith(cause):
            what = cause
        table.add_row(str(row["slot"]), _plain(row["id"]), _plain(level, _STYLES.get(level, "")), _plain(what))
    return table


def _array(document: Json) -> Text:
    digits = ["-" if digit is None else str(digit) for digit in document.get("status_array", ())]
    levels = [str(row["level"]) for row in document.get("checks", ())]
    counts = ", ".join(f"{levels.count(level)} {level}" for level in _STYLES)
    return Text(f"Status Array: [{', '.join(digits)}]   {counts}")


def _health(health: Json) -> list[RenderableType]:
    """Links, counters and problems of PHM itself."""
    parts: list[RenderableType] = []
    for link in health.get("links", ()):
        state = "open" if link["open"] else f"closed: {link['error']}"
        parts.append(_plain(f"link {link['name']}: {state}{_sent(link)}", "" if link["open"] else "yellow"))
    fleet = health.get("reporters", {}).get("fleet")
    if fleet:
        state = "connected" if fleet["connected"] else f"not connected: {fleet['error']}"
        words = f"fleet {fleet['fleet']}: {state} ({fleet['published']} published, {fleet['bytes_out']} bytes)"
        parts.append(_plain(words, "" if fleet["connected"] else "yellow"))
    critical = health.get("flight_critical")
    if critical:
        free = critical["armed"] == "disarmed"
        words = f"flight-critical {', '.join(critical['containers'])}: {'recovery allowed' if free else 'recovery suppressed'}"
        parts.append(_plain(f"{words}, {critical['why']}", "" if free else "yellow"))
    dropped = ", ".join(f"{name} {count}" for name, count in health.get("dropped", {}).items())
    counters = f"events dropped: {dropped or 'none'}; ROS child restarts: {health.get('ros_restarts', 0)}"
    parts.append(_plain(counters))
    late_percent = health.get("late_percent", 0)
    if late_percent >= LATE_PERCENT:
        parts.append(_plain(f"PHM was starved of CPU for {late_percent:.0f} % of the last minute", "yellow"))
    process = health.get("process", {})
    if any(process.values()):
        parts.append(_plain(f"priority: nice {process.get('nice')}, oom_score_adj {process.get('oom_score_adj')}"))
    if health.get("ros_sandbox"):
        parts.append(_plain(f"ROS child not fully restricted: {health['ros_sandbox']}", "yellow"))
    parts += [_plain(f"overdue: {name}", "yellow") for name in health.get("overdue", ())]
    parts += [_plain(f"problem: {text}", "yellow") for text in health.get("problems", ())]
    return parts


def _sent(link: Json) -> str:
    """Traffic of a link: bytes sent, and messages sent and dropped by priority."""
    words = [f"{link['bytes_out']} bytes sent"] if "bytes_out" in link else []
    for kind, count in link.get("sent", {}).items():
        counts = [f"{count[word]} {word}" for word in ("sent", "coalesced", "dropped") if count.get(word)]
        words += [f"{kind} {', '.join(counts)}"] if counts else []
    if link.get("slowed", 1) > 1:
        words.append(f"slowed down {link['slowed']:g} times by radio flow control")
    return f" ({'; '.join(words)})" if words else ""


def _table(*columns: str) -> Table:
    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in columns:
        last = name == columns[-1]
        table.add_column(name, no_wrap=name in ("slot", "level"), overflow="fold", ratio=1 if last else None)
    return table


def _plain(text: object, style: str = "") -> Text:
    return Text(one_line(str(text)), style)


def _duration(seconds: float) -> str:
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"
