"""The kernel reports changes of directories, with real directories of this machine."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from phm.core.clock import SystemClock
from phm.probes.devices import Devices
from phm.probes.inotify import MOST_NAMES, UNUSED_S, FileWatcher, Watch
from phm.testing import FakeClock, settings
from tests.fakes.until import until

LIMIT_S = 60.0


class Listener:
    """Counts its calls."""

    def __init__(self) -> None:
        self.times = 0
        self._called = threading.Semaphore(0)

    def __call__(self) -> None:
        self.times += 1
        self._called.release()

    def called(self) -> bool:
        """Wait for the next call."""
        return self._called.acquire(timeout=LIMIT_S)

    def silent(self) -> bool:
        """Nothing more arrives. This only limits the wait: a change would be reported within milliseconds."""
        return not self._called.acquire(timeout=0.2)


@pytest.fixture
def watcher() -> Iterator[FileWatcher]:
    made = FileWatcher(SystemClock())
    yield made
    made.close()


def watching(watcher: FileWatcher, folder: Path, name: str, *, content: bool = False) -> tuple[Listener, Watch]:
    listener = Listener()
    watch = watcher.on(listener, content=content)
    assert watch(str(folder), name)
    return listener, watch


CHANGES: dict[str, Callable[[Path], object]] = {
    "removed": lambda file: file.unlink(),
    "chmod": lambda file: file.chmod(0o600),
    "replaced": lambda file: (file.with_name("new").write_text("b"), file.with_name("new").rename(file)),
    "moved away": lambda file: file.rename(file.with_name("other")),
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_of_a_watched_entry_is_reported(watcher: FileWatcher, tmp_path: Path, change: str) -> None:
    """Its creation, its removal and its new permissions."""
    (tmp_path / "file").write_text("a")
    listener, _ = watching(watcher, tmp_path, "file")
    CHANGES[change](tmp_path / "file")
    assert listener.called()


def test_a_new_entry_is_reported(watcher: FileWatcher, tmp_path: Path) -> None:
    """An entry that does not exist yet can be watched."""
    listener, _ = watching(watcher, tmp_path, "file")
    os.mkfifo(tmp_path / "file")
    assert listener.called()


def test_another_entry_of_the_directory_is_not_reported(watcher: FileWatcher, tmp_path: Path) -> None:
    """Only entries that were requested."""
    listener, _ = watching(watcher, tmp_path, "file")
    (tmp_path / "log").write_text("a")
    assert listener.silent()


def test_a_new_entry_that_matches_a_pattern_is_reported(watcher: FileWatcher, tmp_path: Path) -> None:
    """Its name need not be known before; other names do not count."""
    listener, _ = watching(watcher, tmp_path, "ttyUSB*")
    (tmp_path / "ttyACM0").touch()
    assert listener.silent()
    (tmp_path / "ttyUSB7").touch()
    assert listener.called()


def test_new_content_is_reported_to_listeners_for_content(watcher: FileWatcher, tmp_path: Path) -> None:
    """A device that is opened and closed has not changed; a file that was written has."""
    (tmp_path / "file").write_text("a")
    device, _ = watching(watcher, tmp_path, "file")
    file, _ = watching(watcher, tmp_path, "file", content=True)
    (tmp_path / "file").write_text("b")
    assert file.called() and device.silent()


def test_watching_twice_returns_false(watcher: FileWatcher, tmp_path: Path) -> None:
    """True only when the watch started: earlier observations may be outdated then."""
    _, watch = watching(watcher, tmp_path, "file")
    assert not watch(str(tmp_path), "file")
    assert not watch(str(tmp_path / "none"), "file"), "a missing directory cannot be watched"


def test_a_recreated_directory_is_watched_again(watcher: FileWatcher, tmp_path: Path) -> None:
    """Its removal is reported, and the next request watches the new one."""
    folder = tmp_path / "folder"
    folder.mkdir()
    listener, watch = watching(watcher, folder, "file")
    folder.rmdir()
    assert listener.called()
    folder.mkdir()
    assert watch(str(folder), "file")
    (folder / "file").write_text("a")
    assert listener.called()


def test_a_moved_directory_is_no_longer_watched(watcher: FileWatcher, tmp_path: Path) -> None:
    """Another one may have its path."""
    folder = tmp_path / "folder"
    folder.mkdir()
    listener, watch = watching(watcher, folder, "file")
    folder.rename(tmp_path / "elsewhere")
    assert listener.called()
    (tmp_path / "elsewhere" / "file").write_text("a")
    assert listener.silent()
    folder.mkdir()
    assert watch(str(folder), "file")


def test_an_entry_that_changes_all_the_time_is_reported_at_intervals(watcher: FileWatcher, tmp_path: Path) -> None:
    """A file that is written continuously does not keep its check busy, and its last change is reported."""
    listener, _ = watching(watcher, tmp_path, "file", content=True)
    began = time.monotonic()
    for number in range(200):
        (tmp_path / "file").write_text(str(number))
        threading.Event().wait(0.005)
    # Usually all of this takes a second. Without limited intervals there would be almost twenty in each second.
    assert listener.times < 9 + time.monotonic() - began
    before = listener.times
    (tmp_path / "file").write_text("last")
    until(lambda: listener.times > before, "the last change")


def test_a_listener_that_raises_does_not_end_the_watcher(watcher: FileWatcher, tmp_path: Path) -> None:
    """Its defect costs one call."""
    listener = Listener()

    def fail() -> None:
        listener()
        raise ZeroDivisionError

    watch = watcher.on(fail)
    assert watch(str(tmp_path), "file")
    (tmp_path / "file").write_text("a")
    assert listener.called()
    (tmp_path / "file").unlink()
    assert listener.called()


def test_names_that_an_application_invents_displace_no_configured_name(tmp_path: Path) -> None:
    """By links that it changes all the time. Names that are looked at no more make room for new ones."""
    clock, folder = FakeClock(), str(tmp_path)
    watcher = FileWatcher(clock)
    watch = watcher.on(lambda: None)
    try:
        assert watch(folder, "configured")
        for number in range(2 * MOST_NAMES):
            assert watch(folder, f"invented_{number}") is (number < MOST_NAMES - 1)
        clock.advance(UNUSED_S)
        for number in range(2 * MOST_NAMES):
            assert not watch(folder, "configured"), "it is watched as before"
            assert watch(folder, f"later_{number}") is (number < MOST_NAMES - 1)
        (directory,) = watcher._directories.values()
        assert len(directory.wanted) == MOST_NAMES
    finally:
        watcher.close()


def test_a_device_behind_a_symlink_is_followed_through_all_steps(watcher: FileWatcher, tmp_path: Path) -> None:
    """Directory, symlink and device may each come and go; the directory may be missing at first."""
    listener = Listener()
    devices = Devices(settings(host={"dev_root": str(tmp_path)}).host, SystemClock(), watcher, listener)
    assert devices.inspect("/dev/serial/by-id/radio", open_it=False) is None
    assert listener.called(), "the watch has started, and the device is checked once more"
    for change in (
        lambda: (tmp_path / "serial").mkdir(),
        lambda: (tmp_path / "serial/by-id").mkdir(),
        lambda: (tmp_path / "serial/by-id/radio").symlink_to("../../ttyUSB0"),
        lambda: (tmp_path / "ttyUSB0").write_text("a"),
    ):
        change()
        assert listener.called()
        devices.inspect("/dev/serial/by-id/radio", open_it=False)
        until(listener.silent, "the last change")
    fact = devices.inspect("/dev/serial/by-id/radio", open_it=False)
    assert fact is not None and fact.path == "/dev/ttyUSB0"
