"""SIGKILL at any moment takes no event that the log has accepted; rotations and compressions are always at work here."""

from __future__ import annotations

import os
import random
import time
from pathlib import Path

import pytest

from tests.reporters.durability._writer import Writer, events, events_in, numbers_in, of_run

USUAL = 100
TIMES = int(os.environ.get("PHM_KILLS", USUAL))
"""With rotations every 60 events. `PHM_KILLS=1000` in the environment makes it a long test (docs/reference/logs.md)."""
KILLS = pytest.param(TIMES, marks=[pytest.mark.long] if TIMES > USUAL else [], id=f"{TIMES} kills")


def killed(directory: Path, run: int, draw: random.Random, **sizes: int) -> Writer:
    """A writer that was killed at a random moment, after its first event."""
    made = Writer(directory, run, **sizes)
    made.until(lambda: made.written > 0)
    time.sleep(draw.uniform(0.0, 0.03))
    made.kill()
    return made


@pytest.mark.parametrize("times", [KILLS])
def test_no_accepted_event_is_lost(tmp_path: Path, times: int) -> None:
    """All runs write into the same files, as restarts of PHM do; `seq` has no gap, and nothing is there twice."""
    draw = random.Random(17)
    for run in range(1, times + 1):
        # All files together hold more than one run writes, so none of it is removed before it is compared.
        made = killed(tmp_path, run, draw, max_size=20_000, files=100)
        lines = of_run(tmp_path, run)
        found = events_in(lines)
        assert found == list(range(1, len(found) + 1)), f"run {run}"
        # The last event may be in the file before its number was in the pipe.
        assert made.written <= len(found) <= made.written + 1, f"run {run}"
        seqs = numbers_in(lines)
        assert seqs == list(range(1, len(seqs) + 1)), f"run {run}"


@pytest.mark.parametrize("seed", range(5))
def test_a_compression_that_is_interrupted_loses_nothing(tmp_path: Path, seed: int) -> None:
    """The next start completes or repeats it, and leaves no temporary file."""
    draw = random.Random(seed)
    for run in (1, 2, 3):
        made = killed(tmp_path, run, draw, max_size=20_000, files=100)
        assert len(events(tmp_path, run)) >= made.written
    assert events(tmp_path, 1)[0] == 1
    last = Writer(tmp_path, 4, max_size=20_000, files=100)

    def left() -> list[str]:
        names = [path.name for path in tmp_path.iterdir()]
        return [name for name in names if name.endswith(".tmp") and str(last.pid) not in name]

    last.until(lambda: last.written > 200 and not left())  # the thread that removes them has the lowest priority
    last.kill()
    assert left() == []
