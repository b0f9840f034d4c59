"""The state of one agent as the ground knows it: its last reports, and when they were received. Pure."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from phm.core.duplicate_filter import DuplicateFilter
from phm.core.model import Level, Slot, Stamp
from phm.gcs.frames import BOOT, Heartbeat
from phm.gcs.presence import Presence, PresenceState
from phm.gcs.statustext_parser import LineKind, ParsedLine, matches
from phm.wire import status_word
from phm.wire.command import CONTAINERS_TEXT, MAX_NAME
from phm.wire.status_line import ARRAY_SLOTS, agent_name
from phm.wire.tunnel import FaultDetail, PeerView

PHM_COMPONENT = 193
MAX_BAD = 10
"""Failing units that are kept for a slot: PHM sends up to ten again for a new ground station, and all may be of one slot."""
MAX_LINES = 2
"""Lines about changes that are kept of a failing unit: FAIL and GAVE UP."""
MAX_DETAILS = 4
MAX_ADVICE, MAX_CONTAINERS = 8, 64
MAX_CHANGES, AGAIN_S = 16, 5.0
"""An agent with two links to the ground sends everything twice, in frames with different sequence numbers."""


@dataclass(frozen=True, slots=True)
class ReceivedText:
    """A line of text, its severity, when it was received, and the agent that relayed it (0: its own)."""

    text: str
    severity: int
    at: Stamp
    via: int = 0


@dataclass(frozen=True, slots=True)
class ReportedProblem:
    """A unit that was reported as WARN or ERROR, with its text."""

    level: Level
    text: str
    at: Stamp
    lines: tuple[str, ...] = ()
    """Word and text of the lines about changes by which it was reported at this level; a refresh raises no alarm."""


@dataclass(frozen=True, slots=True)
class Advice:
    """An action that waits for the operator's approval. fault: its number. valid_s: how long an approval is valid, None: unknown.
    doubtful: its slot has been unknown since, so that its fault may be over.
    """

    fault: int
    slot: int
    action: str
    target: str
    valid_s: float | None
    at: Stamp
    doubtful: bool = False


@dataclass(slots=True)
class Agent:
    """`system` and `component` are its MAVLink ids. What it has not sent is None or empty."""

    system: int
    component: int
    presence: Presence = field(default_factory=Presence)
    link: str = ""
    first: Stamp | None = None
    last: Stamp | None = None
    """When its first and its last heartbeat were received."""
    word: int | None = None
    state: int | None = None
    levels: Mapping[Slot, Level] = field(default_factory=dict)
    """The level of each slot by its last status word."""
    newer: dict[Slot, Level] = field(default_factory=dict)
    """The level of each slot by its lines since that status word."""
    problem: str = ""
    """Why its status word cannot be read, else empty."""
    partial: bool = False
    """Its last refresh reported that some slots are unknown."""
    on_hold: bool = False
    """By its lines: all unknown slots are on hold, or a hold has begun and has not ended."""
    last_text: ReceivedText | None = None
    bad: dict[int, OrderedDict[str, ReportedProblem]] = field(default_factory=dict)
    """Reported problems by slot, then by text, oldest first."""
    advice: OrderedDict[int, Advice] = field(default_factory=OrderedDict)
    """Advised actions by the number of their fault, oldest first."""
    containers: tuple[str, ...] = ()
    """Its configured containers in order, once it was asked for them."""
    view: PeerView | None = None
    view_at: Stamp | None = None
    no_ground: bool | None = None
    """It does not receive the ground, by its own view or by another agent's report."""
    restarts: int = 0
    late: int = 0
    """How often its heartbeats paused."""
    is_late: bool = False
    """It was late at the last look."""
    shown: PresenceState = PresenceState.NEVER
    """Its presence in the last event about it."""
    hop: object = None
    """Its first broken hop, as in the last event about it."""
    details: OrderedDict[str, dict[int, FaultDetail]] = field(default_factory=OrderedDict)
    refreshed: dict[LineKind, str] = field(default_factory=dict)
    """The newest line of each kind that repeats."""
    changes: DuplicateFilter[str, bool] = field(default_factory=lambda: DuplicateFilter(MAX_CHANGES, AGAIN_S))
    """Lines about changes that were received a short time ago."""

    @property
    def name(self) -> str:
        """``A07``; with the component where it is not PHM's usual one."""
        usual = self.component in (PHM_COMPONENT, 0)
        return agent_name(self.system) if usual else f"{agent_name(self.system)}/{self.component}"

    @property
    def current(self) -> Mapping[Slot, Level]:
        """What was reported last about each slot, by a status word or by a line."""
        return {**self.levels, **self.newer}

    @property
    def worst(self) -> Level | None:
        """The worst level by its last status word and newer lines; None: it reported no slot."""
        known = max(self.current.values(), key=lambda level: level.severity, default=None)
        return Level.STALE if known is Level.OK and self.partial else known

    def heartbeat(self, beat: Heartbeat) -> dict[Slot, tuple[Level, Level]]:
        """Take over its status word; the slots that differ from the last word, or from a line since then, with their old and new
        level."""
        if beat.state == BOOT and self.state not in (BOOT, None):
            self.restarts += 1
            self.bad.clear()
            self.advice.clear()
            self.forget_containers()
            self.view, self.view_at, self.no_ground = None, None, None
        try:
            levels, self.problem = status_word.decode(beat.custom_mode), ""
        except ValueError as error:
            levels, self.problem = {}, str(error)
        old, current, self.levels = self.levels, self.current, levels
        self.newer.clear()
        self.word, self.state = beat.custom_mode, beat.state
        for slot in [slot for slot in self.bad if not levels.get(Slot(slot), Level.STALE).bad]:
            del self.bad[slot]
        for fault, one in list(self.advice.items()):
            level = levels.get(Slot(one.slot), Level.STALE)
            if level is Level.OK:
                del self.advice[fault]
            elif not level.bad:  # PHM does not send it again when its unit is known again
                self.advice[fault] = replace(one, doubtful=True)
        pairs = [
            (slot, known.get(slot, Level.STALE), levels.get(slot, Level.STALE))
            for known in (current, old)
            for slot in Slot
        ]
        return {slot: (before, now) for slot, before, now in pairs if before is not now}

    def line(self, line: ParsedLine, at: Stamp) -> None:
        """Take over a line that this agent sent about itself."""
        if line.kind is LineKind.REFRESH:
            self.partial = line.word in ("STALE", "HOLD")
            if line.level is None:
                self.on_hold = line.word == "HOLD"
            if line.word == "OK":
                self.bad.clear()
        elif line.word == "HOLD":
            self.on_hold = not line.text.endswith(" released")
        else:
            self._advised(line, at)
        if line.level is not None:
            self._worse(line, line.level, at)
        elif line.recovered:
            if line.recovered.startswith("GCS:"):
                self.no_ground = False
            units = self.bad.get(line.slot, OrderedDict())
            over = [text for text in units if line.resolves(text)]
            for text in over:
                del units[text]
            # Of a failure whose text changed others may be left: it is not reported any more, and its next line is new.
            units.update({text: replace(bad, lines=()) for text, bad in units.items()})
            if over:
                self._better(Slot(line.slot), units)
        self._array(line)

    def _advised(self, line: ParsedLine, at: Stamp) -> None:
        """Take over what waits for an approval, and what no longer does."""
        found = line.advice
        if found is not None:
            for fault, one in list(self.advice.items()):
                same = (one.slot, one.action, one.target) == (line.slot, found.action, found.target)
                if fault == found.fault or (one.doubtful and same):
                    del self.advice[fault]
            self.advice[found.fault] = Advice(found.fault, line.slot, found.action, found.target, found.valid_s, at)
            while len(self.advice) > MAX_ADVICE:
                self.advice.popitem(last=False)
        elif line.word == "GAVE UP":
            self.advice.pop(line.fault or 0, None)
        elif line.word == "APPROVED":
            for fault, one in list(self.advice.items()):
                if one.slot == line.slot and matches(line.text, f"{one.action} {one.target}"):  # ADVISE has less room
                    del self.advice[fault]

    def forget_containers(self) -> None:
        """Its configuration may have changed: neither the list nor parts of it count any more."""
        self.containers = ()
        self.details.pop(CONTAINERS_TEXT, None)

    def take_text(self, about: str, text: str) -> None:
        """Take over the list of containers."""
        if about == CONTAINERS_TEXT:
            self.containers = tuple(piece.partition(" ")[2][:MAX_NAME] for piece in text.split(", ")[:MAX_CONTAINERS])

    def _array(self, line: ParsedLine) -> None:
        """Take over the digits of a refresh, as far as they contradict what was reported before: `1` is OK or WARN."""
        for slot, digit in zip(ARRAY_SLOTS, line.array, strict=False):
            bad = self.current.get(slot) is Level.ERROR
            if digit == "0" and not bad:
                self.newer[slot] = Level.ERROR
            elif digit != "0" and bad:
                self.newer[slot] = Level.OK if digit == "1" else Level.STALE

    def _better(self, slot: Slot, left: Mapping[str, ReportedProblem]) -> None:
        """A known failure ended: the worst of those that are left counts, and without any the slot is OK."""
        if self.current.get(slot, Level.STALE).bad:
            levels = (bad.level for bad in left.values())
            self.newer[slot] = max(levels, key=lambda level: level.severity, default=Level.OK)

    def _worse(self, line: ParsedLine, level: Level, at: Stamp) -> None:
        """A unit fails. A refresh repeats the worst one, whose own line may have been lost, and may know no other. GAVE UP is about
        a known one, too."""
        if line.slot and level.severity > self.current.get(Slot(line.slot), Level.STALE).severity:
            self.newer[Slot(line.slot)] = level
        units = self.bad.setdefault(line.slot, OrderedDict())
        known = next((text for text in units if line.is_about(text)), None)
        old = units[known] if known is not None else None
        lines = old.lines if old is not None and old.level is level else ()
        if line.kind is LineKind.CHANGE:
            lines = (*(one for one in lines if one != _key(line)), _key(line))[-MAX_LINES:]
        if old is not None and (line.kind is LineKind.REFRESH or line.word == "GAVE UP"):
            reported = replace(old, level=level, lines=lines)
        else:
            reported = ReportedProblem(level, line.failure, at, lines)
        units.pop(reported.text, None)
        units[reported.text] = reported
        while len(units) > MAX_BAD:
            units.popitem(last=False)
        if line.alone:
            self.bad = {line.slot: OrderedDict({reported.text: reported})}

    def repeats(self, line: ParsedLine, text: str, now: float) -> bool:
        """Whether the line is a repetition. Agents send all failures again to each ground station that appears: such a line is one
        until its failure has ended. Call it before `line`."""
        if line.kind is not LineKind.CHANGE:
            old, self.refreshed[line.kind] = self.refreshed.get(line.kind), text
            return old == text
        again = self.changes.get(text, now) is not None
        self.changes.add(text, True, now)
        return again or any(_key(line) in bad.lines for bad in self.bad.get(line.slot, {}).values())

    def newest(self, slot: int, level: Level) -> ReportedProblem | None:
        """The newest unit of this level that was reported for a slot."""
        found = [bad for bad in self.bad.get(slot, {}).values() if bad.level is level]
        return found[-1] if found else None

    def part(self, detail: FaultDetail) -> str | None:
        """A part of the text about a fault; the complete text when no other part is missing."""
        parts = self.details.pop(detail.fault, {})
        if any(other.parts != detail.parts for other in parts.values()):
            parts = {}
        self.details[detail.fault] = {**parts, detail.part: detail}
        while len(self.details) > MAX_DETAILS:
            self.details.popitem(last=False)
        parts = self.details[detail.fault]
        if len(parts) < detail.parts:
            return None
        del self.details[detail.fault]
        return b"".join(parts[number].text for number in sorted(parts)).decode("utf-8", "replace")


def _key(line: ParsedLine) -> str:
    return f"{line.word} {line.text}"
