"""Which readers of logs continue where they were after the configuration is reloaded."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from phm import testing
from phm.core.clock import SystemClock
from phm.probes.logs import RESUME_S, Logs
from phm.probes.pattern_matcher import PatternMatcher
from phm.transport.docker import DockerEngine


class Reloads:
    """The probe of the daemon that runs now, for one log."""

    def __init__(self, path: Path) -> None:
        self.path, self.clock, self.matcher = path, testing.FakeClock(), PatternMatcher(SystemClock(), limit_s=60.0)
        self.now = self.new()

    def new(self) -> Logs:
        return Logs(DockerEngine("unix:///nothing"), lambda key: None, self.clock, self.matcher)

    def reload(self) -> None:
        before, after = self.now.hand_over(), self.new()
        self.now.close()
        after.resume(before)
        self.now = after

    def lines(self) -> int:
        return self.now.follow("app", patterns=["FATAL"], timeout_s=60.0, path=str(self.path)).counts[0]

    def write(self) -> None:
        with self.path.open("a") as log:
            log.write("FATAL\n")


@pytest.fixture
def reloads(tmp_path: Path) -> Iterator[Reloads]:
    (tmp_path / "app.log").write_text("")
    made = Reloads(tmp_path / "app.log")
    assert made.lines() == 0
    yield made
    made.now.close()
    made.matcher.close()


def test_two_reloads_before_the_next_run_lose_no_line(reloads: Reloads) -> None:
    """The check was configured all the time, and had no turn in between."""
    reloads.reload()
    reloads.write()
    reloads.reload()
    assert reloads.lines() == 1


def test_a_check_that_was_absent_begins_at_the_end_of_its_log(reloads: Reloads) -> None:
    """An operator who takes a check out of the configuration does not want what was written meanwhile to restart anything."""
    reloads.now.memory("app").found["FATAL"] = (reloads.clock.mono(), 1, "FATAL")
    reloads.reload()
    reloads.write()
    reloads.clock.advance(RESUME_S)
    reloads.reload()
    assert reloads.now.memory("app").found == {}
    assert reloads.lines() == 0
    reloads.write()
    assert reloads.lines() == 1
