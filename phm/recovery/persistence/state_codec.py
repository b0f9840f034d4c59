"""The state as JSON: `encode` makes the document of `state.json`, `decode` reads it. Pure.

Times are kept on both clocks with the boot id of the machine: on the same boot the monotonic clock continues; on another,
ages are differences of UTC, never negative. `phm.recovery.persistence.state_file` reads and writes the file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from phm.core.clock import MAX_STEPS
from phm.core.model import Evidence, Fault, Layer, Level, Result, Slot, Stamp
from phm.recovery.base import MAX_SHARES, MAX_WEIGHT, LoweredWeight
from phm.recovery.fault_cases import CLEAN_S, KEPT, MAX_REPORTED, AttemptRecord, PersistedCase, UnfinishedAction
from phm.recovery.holds.hold_registry import MAX_DONE, MAX_HOLDS, Hold, PersistedHold, carried
from phm.recovery.ownership import Generation, StartedBy
from phm.recovery.persistence.state import PersistedState, RecoveryState
from phm.recovery.safety.armed_state import LastArmedState

VERSION = 5
MAX_FAULTS = 256
MAX_TARGETS = 64
MAX_TEXT = 2000
FAULT_AGE_S = 7 * 86400.0
"""The maximum age of a fault: a greater age is due to a clock that was set."""


class InvalidState(Exception):
    """The state file has an unexpected content; the message says what is wrong."""


def encode(state: PersistedState, boot: str, now: Stamp) -> dict[str, Any]:
    """The document; everything in it is limited. `boot` is the machine's boot id."""
    recovery = state.recovery
    newest = sorted(recovery.attempts.items(), key=lambda item: item[1][-1].at if item[1] else 0.0)[-MAX_TARGETS:]
    return {
        "v": VERSION,
        "boot": boot,
        "written": _stamp(now),
        "fault_count": state.fault_count,
        "faults": [_fault(fault) for fault in state.faults[:MAX_FAULTS]],
        "given_up": [_fault(fault) for fault in state.given_up[:MAX_FAULTS]],
        "attempts": {target: [_attempt(each, now) for each in made[-KEPT:]] for target, made in newest if made},
        "cases": {
            name: {
                "refused": False,  # 0.2.0 reads no state without it
                "reported": [text[:MAX_TEXT] for text in case.reported[:MAX_REPORTED]],
                "approved": case.approved[:MAX_TEXT],
                "advised": case.advised[:MAX_TEXT],
            }
            for name, case in list(recovery.cases.items())[:MAX_FAULTS]
        },
        "under_way": {
            target: {
                "fault": action.fault,
                "attempt": _attempt(action.attempt, now),
                "returned": action.returned,
            }
            for target, action in list(recovery.under_way.items())[:MAX_TARGETS]
        },
        "stops": list(recovery.stops[:MAX_TARGETS]),
        "windows": [list(window) for window in recovery.windows[-MAX_DONE:]],
        "lowered": [asdict(entry) for entry in recovery.lowered[:MAX_TARGETS]],
        "holds": [_hold(kept) for kept in recovery.holds[:MAX_HOLDS]],
        "generations": {
            target: _generation_data(generation, now)
            for target, generation in list(recovery.generations.items())[:MAX_TARGETS]
        },
        "armed": None if recovery.armed is None else _last_known(recovery.armed, now),
        "unfinished": dict(list(recovery.unfinished.items())[:MAX_TARGETS]),
        "clock": [list(period) for period in state.clock[-MAX_STEPS:]],
    }


def decode(document: Any, boot: str, now: Stamp, window_s: float) -> PersistedState:
    """The state of `document` with its times on the clocks of now. Raises InvalidState.

    window_s: attempts are never taken to be older than this (their budget and back-off are over by then).
    """
    if not isinstance(document, dict):
        raise InvalidState("it does not contain a JSON object")
    if document.get("v") != VERSION:
        raise InvalidState(f"its version is {str(document.get('v'))[:20]!r}, this PHM writes {VERSION}")
    try:
        clocks = _Clocks(bool(boot) and document["boot"] == boot, now, max(window_s, CLEAN_S))
        clock = _read_clock_steps(document)
        return PersistedState(
            faults=tuple(_read_fault(body, clocks) for body in document["faults"][:MAX_FAULTS]),
            given_up=tuple(_read_fault(body, clocks) for body in document["given_up"][:MAX_FAULTS]),
            recovery=_read_recovery(document, clocks),
            clock=clock if clocks.same_boot else (),
            fault_count=int(document.get("fault_count", 0)),
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        raise InvalidState(f"a part of it is wrong: {type(error).__name__}: {str(error)[:80]}") from None


@dataclass(frozen=True, slots=True)
class _Clocks:
    """Puts moments of an earlier run on the monotonic clock of now. attempts_s: the maximum age of an attempt."""

    same_boot: bool
    now: Stamp
    attempts_s: float

    def carried(self, body: Any, most_s: float) -> Stamp:
        return convert_time(_read_stamp(body), self.now, same_boot=self.same_boot, most_s=most_s)

    def moment(self, body: Any) -> float | None:
        return None if body is None else self.carried(body, self.attempts_s).mono


def _read_recovery(document: dict[str, Any], clocks: _Clocks) -> RecoveryState:
    return RecoveryState(
        attempts={
            str(target): tuple(sorted((_read_attempt(each, clocks) for each in made[-KEPT:]), key=lambda made: made.at))
            for target, made in _first(document["attempts"], MAX_TARGETS)
        },
        cases={str(name): _read_case(body) for name, body in _first(document["cases"], MAX_FAULTS)},
        under_way={
            str(target): UnfinishedAction(
                str(body["fault"]), _read_attempt(body["attempt"], clocks), body.get("returned") is True
            )
            for target, body in _first(document["under_way"], MAX_TARGETS)
        },
        generations={
            str(target): _read_generation(body, clocks) for target, body in _first(document["generations"], MAX_TARGETS)
        },
        armed=_read_armed(document.get("armed"), clocks),
        unfinished={
            str(key)[:MAX_TEXT]: str(who)[:MAX_TEXT] for key, who in _first(document.get("unfinished", {}), MAX_TARGETS)
        },
        holds=tuple(_read_hold(body, clocks) for body in document.get("holds", [])[:MAX_HOLDS]),
        stops=tuple(str(key)[:MAX_TEXT] for key in document.get("stops", [])[:MAX_TARGETS]),
        windows=tuple(
            (str(on)[:MAX_TEXT], str(begin)[:MAX_TEXT]) for on, begin in document.get("windows", [])[-MAX_DONE:]
        ),
        lowered=tuple(_read_lowered(body) for body in document.get("lowered", [])[:MAX_TARGETS]),
    )


def _first(entries: Mapping[str, Any], most: int) -> list[tuple[str, Any]]:
    return list(entries.items())[:most]


def _read_attempt(body: Any, clocks: _Clocks) -> AttemptRecord:
    return AttemptRecord(
        at=clocks.carried(body["at"], clocks.attempts_s).mono,
        unit=str(body["unit"]),
        condition=str(body["condition"]),
        action=str(body["action"]),
        worked=body.get("worked") is True,
        backoff_reset=body.get("backoff_reset") is True,
        not_counted=body.get("not_counted") is True,
        partly=body.get("partly") is True,
        took_s=float(body.get("took_s", 0.0)),
    )


def _read_case(body: Any) -> PersistedCase:
    return PersistedCase(
        reported=tuple(str(text) for text in body["reported"][:MAX_REPORTED]),
        approved=str(body["approved"])[:MAX_TEXT],
        advised=str(body.get("advised", ""))[:MAX_TEXT],
    )


def _read_generation(body: Any, clocks: _Clocks) -> Generation:
    name, started, phm_for = (str(body[key])[:MAX_TEXT] for key in ("id", "started", "phm_for"))
    since, made = clocks.moment(body["since"]), clocks.moment(body["made"])
    return Generation(name, started, since, made, StartedBy(body["by"]), phm_for)


def _read_armed(body: Any, clocks: _Clocks) -> LastArmedState | None:
    if body is None:
        return None
    since = clocks.carried(body["since"], FAULT_AGE_S).mono
    return LastArmedState(body["armed"] is True, since, body.get("contradicted") is True)


def _read_clock_steps(document: dict[str, Any]) -> tuple[tuple[float, float], ...]:
    return tuple((float(offset), float(begin)) for offset, begin in document.get("clock", [])[-MAX_STEPS:])


def convert_time(then: Stamp, now: Stamp, *, same_boot: bool, most_s: float) -> Stamp:
    """A moment of an earlier run of PHM on the monotonic clock of now: never in the future, at most `most_s` ago."""
    age_s = now.mono - then.mono if same_boot else now.utc - then.utc
    return Stamp(then.utc, now.mono - min(max(age_s, 0.0), most_s))


def _stamp(stamp: Stamp) -> dict[str, float]:
    return {"utc": stamp.utc, "mono": stamp.mono}


def _read_stamp(body: Any) -> Stamp:
    utc, mono = float(body["utc"]), float(body["mono"])
    if not (abs(utc) < 1e12 and abs(mono) < 1e12):
        raise ValueError("a time is out of range")
    return Stamp(utc, mono)


def _moment(mono: float, now: Stamp) -> dict[str, float]:
    """A moment of the monotonic clock on both clocks."""
    return {"utc": round(now.utc - (now.mono - mono), 2), "mono": mono}


def _generation_data(generation: Generation, now: Stamp) -> dict[str, Any]:
    return {
        "id": generation.id[:MAX_TEXT],
        "started": generation.started[:MAX_TEXT],
        "since": None if generation.since is None else _moment(generation.since, now),
        "made": None if generation.made is None else _moment(generation.made, now),
        "by": generation.by.value,
        "phm_for": generation.phm_for[:MAX_TEXT],
    }


def _last_known(last: LastArmedState, now: Stamp) -> dict[str, Any]:
    return {"armed": last.armed, "since": _moment(last.since, now), "contradicted": last.contradicted}


def _hold(kept: PersistedHold) -> dict[str, Any]:
    hold = kept.hold
    return {
        "target": hold.target,
        "source": hold.source,
        "until_mono": hold.until,
        "left_s": kept.left_s,
        "by": hold.by,
        "reason": hold.reason,
        "occurrence": hold.occurrence,
    }


def _read_hold(body: Any, clocks: _Clocks) -> PersistedHold:
    target, source, by, reason, occurrence = (
        str(body[key])[:MAX_TEXT] for key in ("target", "source", "by", "reason", "occurrence")
    )
    until, left_s = float(body["until_mono"]), float(body["left_s"])
    if not (abs(until) < 1e12 and abs(left_s) < 1e12):
        raise ValueError("the end of a hold is not a time")
    hold = carried(
        Hold(target, source, until, by, reason, occurrence), left_s, clocks.now.mono, same_boot=clocks.same_boot
    )
    return PersistedHold(hold, hold.until - clocks.now.mono)


def _read_lowered(body: Any) -> LoweredWeight:
    shares, weight = int(body["shares"]), int(body.get("weight", 0))  # earlier versions did not write the weight
    if not (2 <= shares <= MAX_SHARES and 0 <= weight <= MAX_WEIGHT):
        raise ValueError("an invalid CPU weight")
    key, container, unit = (str(body[part])[:MAX_TEXT] for part in ("key", "id", "unit"))
    return LoweredWeight(key, container, shares, unit, weight)


def _attempt(attempt: AttemptRecord, now: Stamp) -> dict[str, Any]:
    return {
        "at": _moment(attempt.at, now),
        "unit": attempt.unit,
        "condition": attempt.condition,
        "action": attempt.action,
        "worked": attempt.worked,
        "backoff_reset": attempt.backoff_reset,
        "not_counted": attempt.not_counted,
        "partly": attempt.partly,
        "took_s": attempt.took_s,
    }


def _fault(fault: Fault) -> dict[str, Any]:
    result = fault.result
    return {
        "id": fault.id,
        "unit": fault.unit,
        "slot": int(fault.slot),
        "layer": fault.layer.value,
        "opened": _stamp(fault.opened),
        "by": fault.by,
        "blocks": list(fault.blocks[:MAX_FAULTS]),
        "consequences": list(fault.consequences[:MAX_FAULTS]),
        "ok_s": fault.ok_s,
        "ok_since_start_s": fault.ok_since_start_s,
        "ok_in_run_before_s": fault.ok_in_run_before_s,
        "start_seen": fault.start_seen,
        "pause_s": fault.pause_s,
        "result": {
            "summary": result.summary[:MAX_TEXT],
            "brief": result.brief[:MAX_TEXT],
            "condition": result.condition[:MAX_TEXT],
            "target": result.target[:MAX_TEXT],
            "never_ok": result.evidence.never_ok,
            "patient": result.evidence.patient,
            "file": result.evidence.file[:MAX_TEXT],
            "listed": result.evidence.listed,
            "subjects": _subjects(result.evidence.subjects),
        },
    }


def _subjects(names: Sequence[str] | None) -> tuple[str, ...] | None:
    return None if names is None else tuple(str(name)[:MAX_TEXT] for name in names[:MAX_FAULTS])


def _read_fault(body: Any, clocks: _Clocks) -> Fault:
    return Fault(
        str(body["id"])[:MAX_TEXT],
        str(body["unit"]),
        Slot(body["slot"]),
        Layer(body["layer"]),
        _read_result(body["result"]),
        clocks.carried(body["opened"], FAULT_AGE_S),
        by=str(body["by"]),
        blocks=tuple(str(unit) for unit in body["blocks"]),
        consequences=tuple(str(name) for name in body["consequences"]),
        ok_s=float(body.get("ok_s", 0.0)),
        ok_since_start_s=float(body.get("ok_since_start_s", 0.0)),
        ok_in_run_before_s=float(body.get("ok_in_run_before_s", 0.0)),
        start_seen=bool(body.get("start_seen", False)),
        pause_s=float(body.get("pause_s", 0.0)),
    )


def _read_result(body: Any) -> Result:
    summary, brief, condition, target = (
        str(body[key])[:MAX_TEXT] for key in ("summary", "brief", "condition", "target")
    )
    never_ok, listed = body.get("never_ok"), body.get("listed")
    known = Evidence(
        never_ok=never_ok if isinstance(never_ok, bool) else None,
        patient=body.get("patient") is True,
        listed=int(listed) if listed is not None else None,
        file=str(body.get("file", ""))[:MAX_TEXT],
        subjects=_subjects(body.get("subjects")),
    )
    return Result(Level.ERROR, summary, brief, condition, target, evidence=known)
