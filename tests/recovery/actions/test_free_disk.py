"""Old files are removed from a full disk: only those that the configuration permits."""

from __future__ import annotations

import heapq
import os
import re
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from phm import testing
from phm.api import error
from phm.core.clock import Clock
from phm.core.model import Fault, Phase
from phm.core.settings import FreeDiskSettings, Settings
from phm.recovery.actions import free_disk
from phm.recovery.actions.free_disk import FreeDisk
from phm.recovery.base import Action, ActionContext, ActionFailed, ActionSettings, NotYet, Target
from phm.runtime.sections import action_settings
from tests.recovery.simulated_agent import Agent, Containers, Of

DISK_BYTES = 100_000
HOUR_S = 3600.0


def size_of(file: Path) -> int:
    """0 for a file that the action removes at this moment: the count of a file system does not fail, either."""
    try:
        return file.lstat().st_size
    except FileNotFoundError:
        return 0


@pytest.fixture
def disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A disk of DISK_BYTES, whose usage is the sizes of its files."""

    def used(path: str) -> float:
        return 100.0 * sum(size_of(file) for file in Path(path).rglob("*") if not file.is_dir()) / DISK_BYTES

    monkeypatch.setattr(free_disk, "used_percent", used)
    return tmp_path


def put(path: Path, size: int, age_s: float = HOUR_S) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(bytes(size))
    then = time.time() - age_s
    os.utime(path, (then, then))
    return path


def watched(seconds: float = 5 * HOUR_S) -> testing.FakeClock:
    """A clock that has been observed for this long."""
    clock = testing.FakeClock(mono=50_000.0, utc=time.time() - seconds)
    clock.advance(seconds)
    return clock


def settings_of(disk: Path, *rooms: dict[str, Any]) -> Settings:
    """With the default limits: the target is below 76.5 %."""
    return Settings.model_validate(
        {
            "agent": {"name": "a", "id": 1},
            "host": {"free_disk": [{"path": str(disk / "bags"), **room} for room in rooms]},
        }
    )


def ask(disk: Path, *rooms: dict[str, Any], clock: Clock | None = None) -> tuple[FreeDisk, tuple[Any, ...]]:
    settings = settings_of(disk, *rooms)
    target = Target.parse(f"disk:{disk}", settings.containers)
    return FreeDisk(), (target, None, SimpleNamespace(settings=action_settings(settings), clock=clock or watched()))


def run(disk: Path, *rooms: dict[str, Any], clock: Clock | None = None) -> str:
    action, about = ask(disk, *rooms, clock=clock)
    return action.run(*about)


def waits_for(disk: Path, *rooms: dict[str, Any], clock: Clock) -> str:
    action, about = ask(disk, *rooms, clock=clock)
    return action.waits_for(*about)


def test_the_oldest_files_are_removed_until_there_is_space(disk: Path) -> None:
    """Only files that match a pattern, and no more than necessary."""
    oldest = put(disk / "bags/run_1/a.mcap", 20_000, 3 * HOUR_S)
    older = put(disk / "bags/b.mcap", 20_000, 2 * HOUR_S)
    newer = put(disk / "bags/c.mcap", 20_000, HOUR_S)
    put(disk / "log.txt", 38_000)
    said = run(disk, {"files": ["*.mcap"]})
    assert not oldest.exists() and not older.exists() and newer.exists()
    assert said == f"removed 2 old files, 0.0 MB: {disk} is at 58 %"


def test_a_clock_step_makes_no_file_old(disk: Path) -> None:
    """A recording closed a minute ago stays when the clock is set forward; a really old one is removed."""
    clock = watched()
    closed, old = put(disk / "bags/closed.mcap", 40_000, 0.0), put(disk / "bags/old.mcap", 58_000, 3 * HOUR_S)
    clock.advance(60.0)
    clock.jump_utc(HOUR_S)
    run(disk, {"files": ["*.mcap"]}, clock=clock)
    assert closed.exists() and not old.exists()


@pytest.mark.parametrize("stamped_s", [50 * 365 * 24 * HOUR_S, 2 * HOUR_S, 0.0, -HOUR_S])
def test_a_clock_step_before_phms_start_makes_no_file_old(disk: Path, stamped_s: float) -> None:
    """Without a battery-backed clock: files are stamped with the boot's clock, which is set before PHM starts."""
    closed, clock = put(disk / "bags/closed.mcap", 98_000, stamped_s), watched(60.0)
    with pytest.raises(ActionFailed, match="removed 0 old files"):
        run(disk, {"files": ["*.mcap"]}, clock=clock)
    assert closed.exists()


def test_free_disk_waits_until_the_clock_was_observed_long_enough(disk: Path) -> None:
    """Waiting is not an attempt, and ends once files of `older_than` can be distinguished from newer ones."""
    old, clock = put(disk / "bags/old.mcap", 98_000, 24 * HOUR_S), watched(60.0)
    rooms: list[dict[str, Any]] = [{"files": ["*.mcap"]}, {"files": ["*.log"], "older_than": 1200}]
    assert "in another 540 s: before that, the clock may have been set" in waits_for(disk, *rooms, clock=clock)
    clock.advance(541.0)
    assert waits_for(disk, *rooms, clock=clock) == ""
    run(disk, *rooms, clock=clock)
    assert not old.exists()


def test_files_from_before_the_observation_are_removed_first_by_timestamp(disk: Path) -> None:
    """A recording of this flight stamped 1970 is newer than one of yesterday."""
    clock = testing.FakeClock(mono=100.0, utc=100.0)
    clock.advance(100.0)
    first = put(disk / "bags/first.mcap", 38_000, time.time() - clock.utc())
    clock.jump_utc(time.time() - clock.utc())
    clock.advance(HOUR_S)
    older, old = (put(disk / f"bags/{day}.mcap", 20_000, day * 24 * HOUR_S) for day in (2, 1))
    put(disk / "log.txt", 18_000)
    run(disk, {"files": ["*.mcap"]}, clock=clock)
    assert not older.exists() and old.exists() and first.exists()


def test_a_directory_with_many_files_is_read_incrementally(disk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The oldest files are removed, wherever they are listed, and at most MOST are kept in memory."""
    monkeypatch.setattr(free_disk, "MOST", 3)
    files = [put(disk / f"bags/{number}.log", 1000, HOUR_S + 60 * (number * 37 % 100)) for number in range(99)]
    most: list[int] = []
    smallest = heapq.nsmallest

    def nsmallest(count: int, found: Iterable[Any]) -> list[Any]:
        most.append(count)
        return smallest(count, found)

    monkeypatch.setattr(heapq, "nsmallest", nsmallest)
    oldest = sorted(files, key=lambda file: file.stat().st_mtime)[:3]
    with pytest.raises(ActionFailed, match="removed 3 old files"):
        run(disk, {"files": ["*.log"]})
    assert most == [3]
    assert [file for file in files if not file.exists()] == sorted(oldest, key=files.index)


def test_no_list_of_all_names_is_built(disk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An application that creates a million files must not exhaust PHM's memory: names are read as needed."""
    put(disk / "bags/one.log", 98_000)
    for number in range(50):
        (disk / f"bags/{number}.txt").touch()
    monkeypatch.setattr(free_disk, "MOST_SEEN", 5)
    taken: list[str] = []

    class Counting:
        def __init__(self, entries: Any) -> None:
            self.entries = entries

        def __enter__(self) -> Any:
            return self

        def __exit__(self, *error: object) -> None:
            self.entries.close()

        def __iter__(self) -> Any:
            for entry in self.entries:
                taken.append(entry.name)
                yield entry

    scandir = os.scandir
    counted = lambda folder=".": Counting(scandir(folder)) if isinstance(folder, int) else scandir(folder)  # noqa: E731
    monkeypatch.setattr(os, "scandir", counted)
    with pytest.raises(ActionFailed, match="removed 0 old files"):
        run(disk, {"files": ["*.none"]})
    assert 0 < len(taken) <= 2 * 6, "read again for what becomes old enough"


def test_unconfigured_and_recent_files_stay(disk: Path) -> None:
    """Only files that match a pattern and are old enough are removed. What becomes old enough is waited for, and nothing else."""
    other, fresh = put(disk / "bags/map.db", 50_000), put(disk / "bags/now.mcap", 48_000, age_s=0.0)
    with pytest.raises(NotYet, match=r"removed 0 old files.*still at 98 %.*no other file that host\.free_disk names"):
        run(disk, {"files": ["*.mcap"]})
    assert other.exists() and fresh.exists()
    with pytest.raises(ActionFailed, match=r"still at 98 %.*nothing else that host\.free_disk names") as failed:
        run(disk, {"files": ["*.none"]})
    assert not isinstance(failed.value, NotYet)


class FullDisk(Agent):
    """The disk is full until a file is removed, with the real action and a clock that was observed for hours."""

    def __init__(self, disk: Path) -> None:
        self._disk = disk
        super().__init__({"host/disk": Of("")}, Containers(), watched(), actions=("free_disk",))
        self.found["host/disk"] = error("full", brief="full", condition="disk_full", target=f"disk:{disk}")

    def _action(self, of: str) -> type[Action]:
        agent = self

        class Deleting(FreeDisk):
            @classmethod
            def applies(cls, target: Target, fault: Fault, settings: ActionSettings) -> bool:
                return True

            def waits_for(self, target: Target, fault: Fault, context: ActionContext) -> str:
                return super().waits_for(target, fault, agent.of_disk(context))

            def run(self, target: Target, fault: Fault, context: ActionContext) -> str:
                return super().run(target, fault, agent.of_disk(context))

        return Deleting

    def of_disk(self, context: ActionContext) -> ActionContext:
        settings = action_settings(settings_of(self._disk, {"files": ["*.mcap"]}))
        return replace(context, settings=settings, clock=self.clock)

    def wait(self, seconds: int) -> None:
        """In big steps."""
        for _ in range(seconds // 5):
            self.clock.advance(5.0)
            if free_disk.used_percent(str(self._disk)) < 90:
                self.found.clear()
            self.step()


@pytest.fixture
def full(disk: Path) -> Iterator[Callable[[], FullDisk]]:
    made: list[FullDisk] = []

    def begin() -> FullDisk:
        """Up to the first decision."""
        made.append(FullDisk(disk))
        made[-1].until(made[-1].actions, "the first decision")
        return made[-1]

    yield begin
    for agent in made:
        agent.stop()
        agent.clock.advance(1000)


def test_files_that_are_too_recent_are_waited_for(disk: Path, full: Callable[[], FullDisk]) -> None:
    """Nothing would try again after three failures, although all could be removed ten minutes later. The reason is logged once."""
    file = put(disk / "bags/a.mcap", 98_000, age_s=60.0)
    agent = full()
    agent.wait(400)
    assert file.exists()
    (waiting,) = agent.actions()
    assert waiting.phase is Phase.REFUSED
    assert re.search(r"no other file .* is old enough \(older_than\), the next one in 5\d\d s", waiting.detail)
    agent.wait(300)
    assert not file.exists()
    assert agent.steps(f"disk:{disk}") == [Phase.REFUSED, Phase.STARTED, Phase.DONE, Phase.VERIFIED]


def test_a_disk_whose_files_become_old_enough_one_by_one_is_not_given_up(
    disk: Path, full: Callable[[], FullDisk]
) -> None:
    """Each attempt removes some, which does not suffice yet: it is not a failure, and the next one follows."""
    for age in range(610, 10, -30):
        put(disk / f"bags/{age}.mcap", 1_000, age_s=age)
    put(disk / "map.db", 78_000)
    agent = full()
    agent.wait(400)
    phases = agent.steps(f"disk:{disk}")
    assert phases.count(Phase.STARTED) > agent.settings.recovery.same_failure
    assert Phase.FAILED not in phases and Phase.ESCALATED not in phases
    assert [event.fault.unit for event in agent.closed()] == ["host/disk"]


def test_the_ages_of_many_recent_files_are_read_once_a_minute(disk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """PHM asks every second what the action waits for, and a folder may have a million files."""
    clock, asked, files = watched(), [0], free_disk._files

    def counted(*args: Any) -> Any:
        asked[0] += 1
        return files(*args)

    monkeypatch.setattr(free_disk, "_files", counted)
    put(disk / "bags/a.mcap", 98_000, age_s=60.0)
    for _ in range(120):
        assert waits_for(disk, {"files": ["*.mcap"]}, clock=clock)
        clock.advance(1.0)
    assert asked == [2]


def test_links_are_not_followed(disk: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """An application that writes there must not make PHM remove files elsewhere."""
    elsewhere = put(tmp_path_factory.mktemp("elsewhere") / "precious.mcap", 10)
    put(disk / "bags/new.txt", 98_000)
    (disk / "bags/linked").symlink_to(elsewhere.parent, target_is_directory=True)
    (disk / "bags/one.mcap").symlink_to(elsewhere)
    with pytest.raises(ActionFailed, match="removed 0 old files"):
        run(disk, {"files": ["*.mcap"]})
    assert elsewhere.exists()


def test_a_directory_behind_a_link_is_not_entered(disk: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Also where the link is above the configured directory."""
    elsewhere = put(tmp_path_factory.mktemp("elsewhere") / "bags/a.mcap", 10)
    put(disk / "new.txt", 98_000)
    (disk / "run").symlink_to(elsewhere.parent.parent, target_is_directory=True)
    with pytest.raises(ActionFailed, match="removed 0 old files"):
        run(disk, {"path": str(disk / "run/bags"), "files": ["*"]})
    assert elsewhere.exists()


def test_a_directory_that_was_replaced_meanwhile_is_not_entered(
    disk: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """A link in its place would lead out of the disk."""
    elsewhere = put(tmp_path_factory.mktemp("elsewhere") / "a.mcap", 10)
    (disk / "bags").mkdir()
    (disk / "bags/run").symlink_to(elsewhere.parent, target_is_directory=True)
    folder = os.open(disk / "bags", os.O_RDONLY)
    try:
        with pytest.raises(OSError):
            free_disk._unlink(folder, "run/a.mcap")
    finally:
        os.close(folder)
    assert elsewhere.exists()


def test_a_missing_directory_is_reported(disk: Path) -> None:
    """The result names the folder and the reason."""
    put(disk / "log.txt", 98_000)
    with pytest.raises(ActionFailed, match=r"bags: No such file or directory"):
        run(disk, {"files": ["*"]})


def test_a_directory_on_another_disk_is_reported_and_not_emptied(disk: Path) -> None:
    """Removing its files would not free the full disk."""
    put(disk / "log.txt", 98_000)
    with pytest.raises(ActionFailed, match=r"removed 0 old files.*/dev/shm is on another disk"):
        run(disk, {"path": "/dev/shm", "files": ["nothing-of-this-name"]})


def test_nothing_is_removed_while_there_is_space(disk: Path) -> None:
    """The action says that it removed no file."""
    kept = put(disk / "bags/a.mcap", 10_000)
    assert run(disk, {"files": ["*"]}).startswith("removed 0 old files")
    assert kept.exists()


def test_free_disk_applies_to_disks_with_configured_files() -> None:
    """To no container, and to no disk without `free_disk`."""
    without = Settings.model_validate({"agent": {"name": "a", "id": 1}})
    room = FreeDiskSettings(path="/data", files=["*.log"])
    allowed = without.model_copy(update={"host": without.host.model_copy(update={"free_disk": [room]})})
    full, other = Target.parse("disk:/data", without.containers), Target.parse("ros_app", without.containers)
    assert full.opted_in and full.key == "/data" and not other.configured
    assert not FreeDisk.applies(other, None, action_settings(allowed))  # type: ignore[arg-type]
    assert FreeDisk.applies(full, None, action_settings(allowed))  # type: ignore[arg-type]
    assert not FreeDisk.applies(full, None, action_settings(without))  # type: ignore[arg-type]
    assert "free space on /data manually" in full.manual_step()


def test_the_usage_of_a_real_disk_is_measured() -> None:
    """A disk that cannot be measured fails the action."""
    assert 0.0 <= free_disk.used_percent("/") <= 100.0
    with pytest.raises(ActionFailed, match="cannot be read"):
        free_disk.used_percent("/no/such/disk")
