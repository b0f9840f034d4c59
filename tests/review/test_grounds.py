"""Two ground stations that record at the same time: the worst level that one received, and the gaps that both had."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from tests.review.records import T0, Ground, report

Line = tuple[float, str]


def ground(folder: Path, run: str, end: float, lines: Sequence[Line]) -> None:
    """A record from 0 s to `end`. lines: level of agent 3, or its presence; it is lost 5 s after its last heartbeat."""
    made = Ground(folder / f"{run}.jsonl", run)
    made.event(0, "presence", agent=3, name="A03", presence="alive", was="never received", silent_s=None)
    for at, word in sorted([*lines, *((float(at), "snapshot") for at in (*range(60, int(end), 60), end))]):
        if word == "snapshot":
            made.event(at, word)
        elif word in ("alive", "lost", "left"):
            silent_s = 5.0 if word == "lost" else None
            made.event(at, "presence", agent=3, name="A03", presence=word, was="", silent_s=silent_s)
        else:
            made.event(at, "slots", agent=3, name="A03", slots={"6": word})
    made.close()


def agent(folder: Path) -> dict[str, Any]:
    (row,) = report(folder)["agents"]
    return {key: row[key] if key == "error_s" else [[a - T0, b - T0, *c] for a, b, *c in row[key]] for key in KEYS}


KEYS = ("error_s", "levels", "link_gaps")


def test_the_worst_level_that_one_of_two_grounds_received_counts(tmp_path: Path) -> None:
    """The second one received the recovery, the first one did not: it is not known which is right."""
    ground(tmp_path, "g1", 100, [(0, "OK"), (10, "ERROR"), (90, "OK")])
    ground(tmp_path, "g2", 200, [(0, "OK"), (10.5, "ERROR"), (50, "OK")])
    made = agent(tmp_path)
    assert (made["error_s"], made["levels"]) == (80.0, [[0, 10, "OK"], [10, 90, "ERROR"], [90, 200, "OK"]])


def test_a_gap_is_one_of_both_grounds_while_both_record(tmp_path: Path) -> None:
    """After the end of the first record, and after the agent left one of them, a gap of the other one is a gap."""
    ground(tmp_path, "g1", 200, [(0, "OK"), (55, "lost"), (80, "alive"), (105, "lost"), (120, "alive")])
    ground(tmp_path, "g2", 400, [(0, "OK"), (65, "lost"), (90, "alive"), (305, "lost"), (330, "alive")])
    made = agent(tmp_path)
    assert made["link_gaps"] == [[60, 80], [300, 330]]
    assert made["levels"] == [[0, 60, "OK"], [80, 300, "OK"], [330, 400, "OK"]]
    ground(tmp_path, "g3", 500, [(0, "OK"), (20, "left")])
    assert agent(tmp_path)["link_gaps"] == [[60, 80], [300, 330]]
