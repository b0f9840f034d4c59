"""The status file shows the daemon's state, and is recognized as outdated when the daemon has ended."""

from __future__ import annotations

import json
import os
import stat
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.core.model import Level, Outcome, Slot, UnitState
from phm.core.settings import Settings
from phm.reporters.status import ALONG_S, CLOSED_FAULTS, StatusReporter
from phm.testing import FakeClock
from phm.wire import status_file, status_word
from tests.fakes.records import closed, context, opened, transition, unit
from tests.fakes.until import until

DEAD = unit("nodes/agent_1/node_1", Slot.NODES, Level.ERROR, "Node is not running", brief="node_1 dead")
BLOCKED = unit("topics/agent_1/topic_1", Slot.TOPICS, Level.STALE, blocked_by=DEAD.unit)


def make(run_dir: Path, states: tuple[UnitState, ...] = (), **parts: Any) -> StatusReporter:
    return StatusReporter.build(context(Settings(run_dir=str(run_dir)), states=lambda: states, **parts))


def document(run_dir: Path) -> dict[str, Any]:
    return status_file.read(str(run_dir))


def fresh(tmp_path: Path, **changes: Any) -> dict[str, Any]:
    """A status that a healthy daemon in this process wrote just now, with `changes`."""
    make(tmp_path, clock=SystemClock()).tick()
    return {**document(tmp_path), **changes}


def judged(tmp_path: Path, **changes: Any) -> str:
    """Why a fresh status is unhealthy; looked at again where the machine let more than 5 s pass between its writing and the look."""

    def in_time() -> list[str]:
        found = status_file.unhealthy(fresh(tmp_path, **changes))
        return [] if " s old" in found else [found]

    return str(until(in_time, "a look in time")[0])


def test_the_status_has_the_report_the_faults_and_phm_itself(tmp_path: Path) -> None:
    """All output of `phm status` comes from one world-readable file."""
    status = make(tmp_path / "run", (DEAD, BLOCKED), health=lambda: {"uptime_s": 4.0})
    status.handle(opened(DEAD))
    seen = document(tmp_path / "run")
    assert (seen["v"], seen["agent"], seen["agent_id"], seen["boot_id"]) == (2, "agent_1", 1, "boot12345678")
    assert (seen["pid"], seen["alive"], seen["written_mono"]) == (os.getpid(), True, 1000.0)
    assert seen["status_array"] == [None, None, None, None, None, 0, None, None]
    assert [check["id"] for check in seen["checks"]] == [DEAD.unit, BLOCKED.unit]
    assert seen["faults"]["open"][0]["blocks"] == [BLOCKED.unit]
    assert seen["health"] == {"uptime_s": 4.0}
    assert status_word.decode(seen["status_word"]) == {Slot.NODES: Level.ERROR}
    assert stat.S_IMODE((tmp_path / "run" / "status.json").stat().st_mode) == 0o644


@pytest.mark.parametrize("armed", [True, False, None])
def test_the_status_has_the_state_of_the_autopilot(tmp_path: Path, armed: bool | None) -> None:
    """The agent's page plots since the arming; null: unknown."""
    StatusReporter.build(replace(context(Settings(run_dir=str(tmp_path))), armed=lambda: armed)).tick()
    assert document(tmp_path)["armed"] is armed


def test_closed_faults_are_kept_up_to_twenty(tmp_path: Path) -> None:
    """A closed fault moves from open to closed with its outcome; the oldest are removed first."""
    status = make(tmp_path)
    for number in range(CLOSED_FAULTS + 3):
        status.handle(opened(DEAD, f"f{number}"))
        status.handle(closed(DEAD, Outcome.RESOLVED, "restart", 2.0, f"f{number}"))
    status.tick()
    faults = document(tmp_path)["faults"]
    assert faults["open"] == []
    assert [fault["fault"] for fault in faults["closed"]] == [f"f{number}" for number in range(3, 23)]
    assert faults["closed"][0]["by"] == "restart"


def test_a_change_is_written_immediately_and_a_burst_once(tmp_path: Path) -> None:
    """The first event writes; events within the next tenth of a second wait for the tick."""
    clock = FakeClock()
    level: list[UnitState] = []
    status = StatusReporter.build(context(Settings(run_dir=str(tmp_path)), clock=clock, states=lambda: tuple(level)))
    status.handle(transition(DEAD))
    level.append(DEAD)
    clock.advance(ALONG_S / 2)
    status.handle(transition(DEAD))
    assert document(tmp_path)["checks"] == []
    status.tick()
    assert len(document(tmp_path)["checks"]) == 1


def test_a_reader_never_sees_an_incomplete_status(tmp_path: Path) -> None:
    """Writing replaces the file: a reader that has it open keeps the complete old one, and no temporary file remains."""
    status = make(tmp_path)
    status.tick()
    with (tmp_path / "status.json").open() as old:
        status.tick()
        assert json.load(old)["v"] == 2
    assert [entry.name for entry in tmp_path.iterdir()] == ["status.json"]


def test_the_status_is_removed_at_shutdown(tmp_path: Path) -> None:
    """`close` removes the file, and ignores that it is already gone."""
    status = make(tmp_path)
    status.tick()
    status.close()
    status.close()
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_run_dir_is_a_problem_without_a_crash(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """The reporter reports the problem, continues, and recovers. The problem is on stderr once, since `phm status` cannot show it."""
    (tmp_path / "run").write_text("a file in the way")
    status = make(tmp_path / "run")
    status.tick()
    assert "status.json: File exists; `phm status` does not work" in status.problem()
    status.tick()
    assert [record.getMessage() for record in caplog.records] == [status.problem()]
    (tmp_path / "run").unlink()
    status.tick()
    assert status.problem() == ""


def test_a_current_status_of_a_live_process_is_healthy(tmp_path: Path) -> None:
    """Written now, on this boot, live, by an existing process."""
    assert judged(tmp_path) == ""


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"alive": False}, "checks have stalled"),
        ({"alive": "yes"}, "checks have stalled"),
        ({"machine_boot": "another-boot"}, "before the machine's last start"),
        ({"written_mono": None}, "does not say when"),
        ({"written_mono": True}, "does not say when"),
        ({"written_mono": 1e12}, "before the machine's last start"),
        ({"written_mono": float("nan")}, "before the machine's last start"),
    ],
)
def test_a_status_with_missing_evidence_is_unhealthy(tmp_path: Path, changes: dict[str, Any], reason: str) -> None:
    """Each condition is needed; a missing or unexpected value counts as unhealthy."""
    assert reason in judged(tmp_path, **changes)


def test_a_status_is_valid_for_five_seconds(tmp_path: Path) -> None:
    """Age is measured on the monotonic clock: setting the wall clock changes nothing."""
    seen = fresh(tmp_path, written_utc="1970-01-01T00:00:00.000Z", written_mono=500.0)
    assert status_file.unhealthy(seen, now_mono=505.0) == ""
    assert "6 s old" in status_file.unhealthy(seen, now_mono=506.0)


def test_the_status_of_a_killed_process_is_unhealthy_immediately(tmp_path: Path) -> None:
    """Ended, or a zombie: both are detected before the file is outdated."""
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        assert judged(tmp_path, pid=process.pid) == ""
        process.kill()
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        assert "is gone" in judged(tmp_path, pid=process.pid)
    assert "is gone" in judged(tmp_path, pid=process.pid)


def test_a_process_of_another_pid_namespace_is_not_looked_up(tmp_path: Path) -> None:
    """Read from the host, the pid means another process; only the age decides."""
    assert judged(tmp_path, pid=2**22 + 1, pid_namespace="pid:[1]") == ""


@pytest.mark.parametrize(
    ("content", "reason"),
    [("{", "is not JSON"), ("[]", "is not a PHM status"), ("\xff", "is not JSON"), (None, "there is no")],
)
def test_a_missing_status_has_a_reason(tmp_path: Path, content: str | None, reason: str) -> None:
    """Missing, truncated and foreign files have different messages."""
    if content is not None:
        (tmp_path / "status.json").write_bytes(content.encode("latin-1"))
    with pytest.raises(status_file.NoStatus, match=reason):
        status_file.read(str(tmp_path))


def test_a_health_check_without_packages_gives_the_same_result(tmp_path: Path) -> None:
    """As run in the image: this file and the standard library only; without typing, which would take a fifth of its
    time.
    """
    script = Path(status_file.__file__)

    def answer(*before: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-I", "-S", *before, str(script)]
        environ = {**os.environ, "PHM_RUN_DIR": str(tmp_path)}
        return subprocess.run(command, env=environ, capture_output=True, text=True, check=False)

    def in_time(*before: str, **changes: Any) -> subprocess.CompletedProcess[str] | None:
        """None: it came more than 5 s after the status was written, which is then refused for its age."""
        seen = fresh(tmp_path, **changes)
        if changes:
            (tmp_path / "status.json").write_text(json.dumps(seen))
        found = answer(*before)
        return None if " s old" in found.stdout else found

    nothing = answer()
    assert nothing.returncode == 1
    assert "PHM is not running" in nothing.stdout
    healthy = until(lambda: in_time("-X", "importtime"), "an answer in time")
    assert (healthy.returncode, healthy.stdout[:15]) == (0, "PHM is healthy:")
    imported = {line.rpartition("|")[2].strip() for line in healthy.stderr.splitlines()}
    assert "json" in imported
    assert imported.isdisjoint({"typing", "site", "click", "phm"})
    stalled = until(lambda: in_time(alive=False), "an answer in time")
    assert stalled.returncode == 1
    assert "checks have stalled" in stalled.stdout
