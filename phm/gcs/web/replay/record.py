"""Reads a record into a timeline: its lines, and the frames that they follow from. Pure, but for reading the file.

A record has the events, and not the heartbeats that changed nothing. These are filled in with the agent's usual period, from each of
its events until it was lost, so that presence and ages are right. Series, such as the gaps between heartbeats, are from its samples
alone: those that are filled in would be made up.
"""

from __future__ import annotations

import json
import re
import struct
import sys
from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from phm.core.model import Level
from phm.gcs.agent import PHM_COMPONENT
from phm.gcs.frames import POWEROFF, STATES, Frame, Heartbeat, RadioStatus, StatusText, TunnelPayload
from phm.wire import json_log, tunnel
from phm.wire.tunnel import PAYLOAD_TYPE, PeerState, PeerView, SwarmDigest, TunnelMessage

Json = Mapping[str, Any]
Ids = tuple[int, int]
"""MAVLink system id and component id."""
MAX_LINES = 2_000_000
"""Also of the heartbeats that are filled in: 2 million need about 0.5 GB."""
MAX_SAMPLES = 2_000_000
MAX_FILLED = 200_000
"""Maximum number of heartbeats of one sender that are filled in without a break."""
LATEST_S = 1e10
"""No moment of a record is later: UTC seconds of the year 2286."""
MAX_SEQ, MAX_RADIOS = 2**53, 64
MAX_NAME, LARGEST = 100, 1e12
PERIOD_S, SHORTEST_S = 2.0, 0.5
BETWEEN_RUNS_S = 1.0
_NAME = re.compile(r"A0*([1-9][0-9]{0,2})(?:/([0-9]{1,3}))?")


_DAMAGED = (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError, struct.error)
"""What reading a damaged line, or one of another version, raises."""


class RecordError(Exception):
    """The file cannot be replayed; the message says why."""


@dataclass(slots=True)
class Entry:
    """at: seconds on the timeline. line: the recorded line; None for a filled-in heartbeat, and for samples. frames: with their links.
    links: the ground's own links: name, whether open, error. samples: name of the sender, series, value."""

    at: float
    line: Json | None = None
    frames: list[tuple[Frame, str]] = field(default_factory=list)
    links: tuple[str, bool, str] | None = None
    samples: tuple[tuple[str, str, float], ...] = ()


@dataclass(frozen=True, slots=True)
class RecordedRun:
    """One run of `phm gcs` in the record: at on the timeline, and UTC seconds, of its first line."""

    at: float
    utc: float


@dataclass(frozen=True, slots=True)
class GroundRecord:
    """entries: in the order of time, which begins at 0."""

    entries: tuple[Entry, ...]
    times: tuple[float, ...]
    runs: tuple[RecordedRun, ...]
    ids: tuple[int, int]

    @property
    def end(self) -> float:
        return self.times[-1]

    def utc(self, at: float) -> float:
        run = self.runs[max(0, bisect_right([run.at for run in self.runs], at) - 1)]
        return run.utc + at - run.at

    def at(self, utc: float) -> float:
        """The moment of a UTC time on the timeline, limited to its ends."""
        starts = [run.utc for run in self.runs]
        run = self.runs[max(0, bisect_right(starts, utc) - 1)]
        return min(max(0.0, run.at + utc - run.utc), self.end)


def load(path: str | Path) -> GroundRecord:
    """Read a record. Raises RecordError."""
    if not Path(path).is_file():
        raise RecordError(f"{path}: there is no such file")
    entries, runs, ids = list[Entry](), list[RecordedRun](), (254, 190)
    run, zero, samples = "", 0.0, 0
    for line in json_log.read(path):
        if not _sound(line) or line["event"] == "received":
            continue  # of the report alone: it has no number of its own
        if line["run"] != run:
            run, at = str(line["run"]), entries[-1].at + BETWEEN_RUNS_S if entries else 0.0
            zero = line["mono"] - at
            runs.append(RecordedRun(at, float(line["utc_s"])))
        if line["event"] == "start":
            ids = _own(line) or ids
        last = entries[-1].at if entries else 0.0
        entry = Entry(max(last, line["mono"] - zero), line)
        try:
            _fill(entry, line)
        except _DAMAGED:
            continue
        entries.append(entry)
        samples += len(entry.samples)
        for count, most, what in ((len(entries), MAX_LINES, "lines"), (samples, MAX_SAMPLES, "samples")):
            if count > most:
                raise RecordError(f"{path}: more than {most} {what}; split it")
    if not entries:
        raise RecordError(f"{path}: it contains no line of `phm gcs --record`")
    entries += _fill_in(entries, path)
    entries.sort(key=lambda entry: entry.at)
    return GroundRecord(tuple(entries), tuple(entry.at for entry in entries), tuple(runs), ids)


def _sound(line: Json) -> bool:
    """Whether it is a line of a record, and can be written as JSON again: no NaN, no half of a surrogate pair."""
    numbers, seq = (line.get("mono"), line.get("utc_s")), line.get("seq", 0)
    if not (
        isinstance(line.get("event"), str)
        and isinstance(line.get("run"), str)
        and all(isinstance(one, (int, float)) and 0 <= one < LATEST_S for one in numbers)
        and isinstance(seq, int)
        and 0 <= seq < MAX_SEQ
    ):
        return False
    try:
        json.dumps(line, ensure_ascii=False, allow_nan=False).encode("utf-8")
    except (ValueError, RecursionError):
        return False
    return True


def _own(line: Json) -> Ids | None:
    """The ids of the ground station in the first line of a run."""
    system, component = line.get("system"), line.get("component", 190)
    if isinstance(system, int) and isinstance(component, int) and 0 < system < 256 and 0 < component < 256:
        return system, component
    return None


def _fill(entry: Entry, line: Json) -> None:
    """The frames that a line follows from. Raises KeyError, TypeError and so on for a damaged one."""
    link = str(line.get("link", "record"))
    match line["event"]:
        case "slots":
            entry.frames.append((_beat(line["name"], line["word"], str(line["state"])), link))
        case "presence" if line["presence"] == "left":
            entry.frames.append((_beat(line["name"], 1 << 30, STATES[POWEROFF]), link))
        case "text":
            said = StatusText(int(line["system"]), int(line["component"]), int(line["severity"]), str(line["text"]))
            entry.frames.append((said, link))
        case "autopilot" if line["presence"] == "alive":
            entry.frames.append((_autopilot(int(line["system"]), line), link))
        case "view":
            peers = {int(key): PeerState[str(seen).upper()] for key, seen in line["peers"].items()}
            view = PeerView(0, bool(line["gcs"]), bool(line["autopilot"]), bool(line["radio"]), peers)
            entry.frames.append((_tunnel(line["name"], view), link))
        case "digest":
            levels = {int(key): Level[str(level)] for key, level in line["levels"].items()}
            digest = SwarmDigest(int(line["members"]), int(line["alive"]), levels)
            entry.frames.append((_tunnel(line["name"], digest), link))
        case "link":
            entry.links = (str(line["link"]), bool(line["open"]), str(line["error"]))
        case "snapshot":
            radios = list(line["radios"])[:MAX_RADIOS]
            entry.frames += [(_radio(radio), str(radio["link"])) for radio in radios if radio["age_s"] < 60]
        case "samples":
            entry.line, entry.samples = None, tuple(_samples(line["samples"]))


def _samples(found: Mapping[str, Mapping[str, float]]) -> Iterator[tuple[str, str, float]]:
    for name, values in found.items():
        for kind, value in values.items():
            if len(name) <= MAX_NAME and len(kind) <= MAX_NAME and abs(value) <= LARGEST:
                yield sys.intern(name), sys.intern(kind), float(value)


def _ids(name: object) -> Ids:
    found = _NAME.fullmatch(str(name))
    if found is None:
        raise ValueError(f"{name} is not the name of an agent")
    return int(found[1]), int(found[2] or PHM_COMPONENT)


def _beat(name: object, word: int, state: str) -> Heartbeat:
    number = STATES.index(state) if state in STATES else int(state)
    return Heartbeat(*_ids(name), 18, 8, 0, int(word), number)


def _autopilot(system: int, line: Json) -> Heartbeat:
    state = str(line["state"])
    number = STATES.index(state) if state in STATES else 4
    return Heartbeat(system, 1, 2, 3, 128 if line["armed"] else 0, int(line["mode"]), number)


def _tunnel(name: object, message: TunnelMessage) -> TunnelPayload:
    return TunnelPayload(*_ids(name), PAYLOAD_TYPE, tunnel.encode(message))


def _radio(radio: Json) -> RadioStatus:
    levels = (radio[key] for key in ("rssi", "remrssi", "noise", "remnoise"))
    rssi, remrssi, noise, remnoise = (None if level is None else int(level) for level in levels)
    return RadioStatus(51, 68, rssi, remrssi, noise, remnoise, int(radio["txbuf"]))


# ---------------------------------------------------------------- heartbeats


class _Filler:
    """Fills in the heartbeats that changed nothing: repeated until the next one, the loss or the end of the run."""

    def __init__(self, path: str | Path) -> None:
        self.found: list[Entry] = []
        self._path = path
        self._open: dict[Ids, tuple[float, Frame, str]] = {}
        """The last heartbeat of each sender, while it is there, and its link."""
        self._known: dict[Ids, tuple[Frame, str]] = {}
        self._periods: dict[Ids, float] = {}
        self._last, self._run = 0.0, ""

    def take(self, entry: Entry) -> None:
        """Take the next line of the record."""
        line = entry.line or {}
        run = str(line.get("run"))
        if run != self._run or line.get("event") == "end":
            self.end(entry.at if run == self._run else self._last)
        self._run, self._last = run, entry.at
        self._periods.update(_periods(line))
        back = _returned(line)
        if back in self._known and not entry.frames:
            entry.frames.append(self._known[back])  # what it says has not changed meanwhile
        for frame, link in entry.frames:
            if isinstance(frame, Heartbeat):
                self._next(frame, link, entry.at)
        for key in _lost(line):
            silent_s = max(0.0, float(line.get("silent_s") or line.get("age_s") or 0.0))
            self._fill(key, entry.at - silent_s, inclusive=True)

    def end(self, at: float) -> None:
        """End all heartbeats at this moment."""
        for key in list(self._open):
            self._fill(key, at)

    def _next(self, frame: Heartbeat, link: str, at: float) -> None:
        key = (frame.system, frame.component)
        self._fill(key, at)
        if frame.state != POWEROFF:
            self._known[key] = (frame, link)
            self._open[key] = (at, frame, link)

    def _fill(self, key: Ids, end: float, *, inclusive: bool = False) -> None:
        """Add a sender's heartbeats up to `end`. inclusive: the last one is exactly at `end`."""
        begun = self._open.pop(key, None)
        if begun is None:
            return
        at, frame, link = begun
        period_s = self._periods.get(key, PERIOD_S)
        for number in range(1, int(min((end - at) / period_s, MAX_FILLED)) + 1):
            if at + number * period_s < end:
                self.found.append(Entry(at + number * period_s, None, [(frame, link)]))
        if len(self.found) > MAX_LINES:
            raise RecordError(f"{self._path}: more than {MAX_LINES} heartbeats; split it")
        if inclusive and end > at:
            self.found.append(Entry(end, None, [(frame, link)]))


def _fill_in(entries: Iterable[Entry], path: str | Path) -> list[Entry]:
    """The entries with the heartbeats filled in. Raises RecordError."""
    filler, last = _Filler(path), 0.0
    for entry in entries:
        if entry.line is not None:
            with suppress(*_DAMAGED):
                filler.take(entry)
        last = entry.at
    filler.end(last)
    return filler.found


def _periods(line: Json) -> Iterator[tuple[Ids, float]]:
    """Of agents, as a snapshot has them; an autopilot sends one a second."""
    if line.get("event") == "autopilot" and isinstance(line.get("system"), int):
        yield (line["system"], 1), 1.0
    if line.get("event") == "snapshot":
        for agent in line.get("agents", ()):
            if isinstance(agent.get("period_s"), (int, float)):
                yield (agent["agent"], agent["component"]), max(SHORTEST_S, float(agent["period_s"]))


def _returned(line: Json) -> Ids:
    """The agent that is back by this line; (0, 0): none."""
    named = _NAME.fullmatch(str(line.get("name")))
    back = named is not None and line.get("event") == "presence" and line.get("presence") == "alive"
    return _ids(line["name"]) if back else (0, 0)


def _lost(line: Json) -> Iterator[Ids]:
    if line.get("presence") != "lost":
        return
    if line["event"] == "presence" and _NAME.fullmatch(str(line.get("name"))):
        yield _ids(line["name"])
    elif line["event"] == "autopilot" and isinstance(line.get("system"), int):
        yield line["system"], 1
