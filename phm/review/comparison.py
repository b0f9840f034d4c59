"""Two records or flights against each other: what is new, gone, worse or better, and what of it may be random. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from phm.review.check_rates import opened, repair_times
from phm.review.sentences import times, vehicles
from phm.review.statistics import same_rate

Json = dict[str, Any]
VERSION = 1
LEVEL = 0.05
"""A difference with a smaller probability, after the correction for many comparisons, is statistically significant."""
VERDICTS = ("new", "worse", "gone", "better", "same")


def build(first: Json, second: Json) -> Json:
    """Rows for each check and each (unit, condition) of two documents of `document.build`.

    `probability` is that of a difference at least as unlikely if both rates are equal; `corrected` by Holm over all rows of the
    list; `chance` whether the difference may be random.
    """
    return {
        "compare": VERSION,
        "a": _about(first),
        "b": _about(second),
        "checks": _rows(_checks(first), _checks(second), "check"),
        "faults": _rows(_faults(first, second), _faults(second, first), "fault"),
    }


def holm(probabilities: Sequence[float | None]) -> list[float | None]:
    """Probabilities corrected for the number of comparisons (Holm 1979); None stays None."""
    order = sorted((p, place) for place, p in enumerate(probabilities) if p is not None)
    result: list[float | None] = [None] * len(probabilities)
    least = 0.0
    for rank, (p, place) in enumerate(order):
        least = max(least, min(1.0, p * (len(order) - rank)))
        result[place] = least
    return result


def _about(document: Json) -> Json:
    versions = sorted({version for agent in document["agents"] for version in agent["versions"]})
    return {
        "window": document["window"],
        "lasted_s": times(document)["duration_s"],
        "agents": len(vehicles(document)),
        "versions": versions,
        "faults": len(opened(document["faults"], document["window"]["begin"])),
        "ran_s": round(_ran_s(document), 3),
        "uptime": document["phm"]["uptime"],
    }


def _ran_s(document: Json) -> float:
    """Agent seconds in which PHM ran: those of the check that was observed longest, which every agent has."""
    return max((float(row["observed_s"]) for row in document["checks"]), default=0.0)


def _checks(document: Json) -> dict[str, tuple[int, float, float | None]]:
    return {row["check"]: (row["faults"], row["observed_s"], row["mttr_s"]) for row in document["checks"]}


def _named(document: Json) -> dict[str, list[Json]]:
    """The faults by unit and condition, over all agents."""
    found: dict[str, list[Json]] = {}
    for fault in opened(document["faults"], document["window"]["begin"]):
        found.setdefault(f"{fault['unit']} {fault['condition']}".strip(), []).append(fault)
    return found


def _faults(document: Json, other: Json) -> dict[str, tuple[int, float, float | None]]:
    """Also of those that only the other record has: their check was observed here without such a fault."""
    ran_s = {row["check"]: float(row["observed_s"]) for row in document["checks"]}
    found, elsewhere = _named(document), _named(other)
    rows: dict[str, tuple[int, float, float | None]] = {}
    for name, known in {**elsewhere, **found}.items():
        faults = found.get(name, [])
        times = repair_times(faults)
        rows[name] = (len(faults), ran_s.get(known[0]["check"], 0.0), sum(times) / len(times) if times else None)
    return rows


def _rows(
    first: dict[str, tuple[int, float, float | None]], second: dict[str, tuple[int, float, float | None]], kind: str
) -> list[Json]:
    """A check that one of the records does not have was observed for no time there."""
    names = [name for name in {**first, **second} if first.get(name, (0,))[0] or second.get(name, (0,))[0]]
    found: list[Json] = []
    for name in names:
        count_a, time_a, mttr_a = first.get(name, (0, 0.0, None))
        count_b, time_b, mttr_b = second.get(name, (0, 0.0, None))
        found.append(
            {
                kind: name,
                "verdict": _verdict(count_a, time_a, count_b, time_b),
                "faults": [count_a, count_b],
                "observed_s": [round(time_a, 3), round(time_b, 3)],
                "per_hour": [_per_hour(count_a, time_a), _per_hour(count_b, time_b)],
                "mttr_s": [_rounded(mttr_a), _rounded(mttr_b)],
                "probability": _rounded(same_rate(count_a, time_a, count_b, time_b), 6),
            }
        )
    corrected = holm([row["probability"] for row in found])
    for row, probability in zip(found, corrected, strict=True):
        row["corrected"] = _rounded(probability, 6)
        row["chance"] = probability is None or probability >= LEVEL
    return sorted(
        found, key=lambda row: (row["chance"], VERDICTS.index(row["verdict"]), row["probability"] or 0.0, row[kind])
    )


def _verdict(count_a: int, time_a: float, count_b: int, time_b: float) -> str:
    if not count_a:
        return "new"
    if not count_b:
        return "gone"
    one, two = count_a * time_b, count_b * time_a
    if math.isclose(one, two, rel_tol=1e-9):
        return "same"
    return "worse" if two > one else "better"


def _per_hour(count: int, seconds: float) -> float | None:
    return round(3600 * count / seconds, 6) if seconds > 0 else None


def _rounded(value: float | None, digits: int = 3) -> float | None:
    return None if value is None else round(value, digits)
