"""The device probe on real device files: those of this machine, and a pseudo-terminal."""

from __future__ import annotations

import errno
import os
import pty
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from phm import testing
from phm.core.clock import SystemClock
from phm.facts import CannotTell, DeviceFact
from phm.probes import devices as module
from phm.probes.devices import Devices
from phm.probes.inotify import FileWatcher


def probe(root: Path | str = "/dev") -> Devices:
    return Devices(testing.settings(host={"dev_root": str(root)}).host, SystemClock())


@pytest.fixture
def host_dev(tmp_path: Path) -> Path:
    """A host's /dev mounted at another path, with udev-style symlinks to this machine's null device."""
    root = tmp_path / "host" / "dev"
    (root / "serial" / "by-id").mkdir(parents=True)
    (root / "not_a_device").write_text("", encoding="ascii")
    (root / "serial" / "by-id" / "relative").symlink_to("../../not_a_device")
    (root / "serial" / "by-id" / "absolute").symlink_to("/dev/not_a_device")
    (root / "serial" / "by-id" / "dangling").symlink_to("../../ttyGONE0")
    (root / "loop_a").symlink_to("loop_b")
    (root / "loop_b").symlink_to("loop_a")
    return root


@pytest.fixture
def terminal() -> Iterator[str]:
    """A real tty: the far end of a pseudo-terminal."""
    near, far = pty.openpty()
    yield os.ttyname(far)
    os.close(near)
    os.close(far)


def test_a_character_device_has_its_numbers() -> None:
    """/dev/null is 1:3 on every Linux."""
    fact = probe().inspect("/dev/null", open_it=True)
    assert fact is not None
    assert (fact.path, fact.character, fact.major, fact.minor, fact.openable) == ("/dev/null", True, 1, 3, True)


def test_a_device_is_opened_only_on_request() -> None:
    """Permission bits alone prove nothing about the device behind the file."""
    fact = probe().inspect("/dev/null", open_it=False)
    assert fact is not None and fact.openable is None and not fact.reason


def test_a_real_terminal_can_be_opened(terminal: str) -> None:
    """Without making it the controlling terminal and without waiting for a carrier."""
    fact = probe().inspect(terminal, open_it=True)
    assert fact is not None and fact.character and fact.openable


def test_a_missing_path_is_none() -> None:
    """Missing is a result, not an error."""
    assert probe().inspect("/dev/phm-no-such-device", open_it=True) is None
    assert probe().inspect("/dev/null/below", open_it=True) is None


def test_a_directory_or_file_is_not_a_character_device(host_dev: Path) -> None:
    """The fact has the kind of the file."""
    folder = probe(host_dev).inspect("/dev/serial", open_it=True)
    file = probe(host_dev).inspect("/dev/not_a_device", open_it=True)
    assert folder is not None and not folder.character and "directory" in folder.reason
    assert file is not None and not file.character and "file" in file.reason


@pytest.mark.parametrize("link", ["relative", "absolute"])
def test_symlinks_are_resolved_within_the_mounted_dev(host_dev: Path, link: str) -> None:
    """An absolute target is a path of the host, not of PHM's container."""
    fact = probe(host_dev).inspect(f"/dev/serial/by-id/{link}", open_it=False)
    assert fact is not None and fact.path == "/dev/not_a_device"


@pytest.mark.parametrize("link", ["/dev/serial/by-id/dangling", "/dev/loop_a"])
def test_a_symlink_without_target_is_none(host_dev: Path, link: str) -> None:
    """Dangling or cyclic: the device does not exist."""
    assert probe(host_dev).inspect(link, open_it=True) is None


def test_an_unmounted_dev_is_an_error(tmp_path: Path) -> None:
    """Otherwise every device would be reported missing."""
    with pytest.raises(CannotTell, match="mount it"):
        probe(tmp_path / "nowhere").inspect("/dev/null", open_it=False)


@pytest.mark.parametrize(
    ("number", "openable"),
    [
        (errno.EBUSY, True),
        (errno.EPERM, None),
        (errno.EACCES, None),
        (errno.ENXIO, False),
        (errno.EIO, False),
        (errno.EINVAL, False),
    ],
)
def test_each_error_of_opening_has_its_result(
    monkeypatch: pytest.MonkeyPatch, number: int, openable: bool | None
) -> None:
    """Busy is OK, a denied permission proves nothing, a missing device behind the file is refused; each with a reason."""

    def refuse(*_: object, **__: object) -> int:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "open", refuse)
    fact = probe().inspect("/dev/null", open_it=True)
    monkeypatch.undo()
    assert fact is not None and fact.openable is openable and fact.reason


def test_a_device_that_hangs_while_it_is_opened_hides_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each device is opened in its own thread; only the one that hangs is unknown."""
    released, made, opened = threading.Event(), probe(), os.open

    def hang(path: Path, *rest: int, **named: int) -> int:
        if str(path) == "/dev/zero":
            released.wait()
        return opened(path, *rest, **named)

    monkeypatch.setattr(os, "open", hang)
    monkeypatch.setattr(module, "INSPECT_S", 60.0)
    made.inspect("/dev/zero", open_it=False)  # its thread runs, so that the next call waits for `open` alone
    monkeypatch.setattr(module, "INSPECT_S", 0.5)
    with pytest.raises(CannotTell):
        made.inspect("/dev/zero", open_it=True)
    monkeypatch.setattr(module, "INSPECT_S", 60.0)
    other = made.inspect("/dev/null", open_it=True)
    assert other is not None and other.openable
    assert made.inspect("/dev/phm-no-such-device", open_it=True) is None
    assert made.matching(["/dev/nul?"])
    with pytest.raises(CannotTell, match="has not returned"):
        made.inspect("/dev/zero", open_it=True)
    released.set()
    made.close()


def test_a_file_without_a_device_behind_it_is_refused() -> None:
    """The kernel's own error: a process without a controlling terminal cannot open /dev/tty."""
    code = (
        "from phm import testing; from phm.core.clock import SystemClock; from phm.probes.devices import Devices\n"
        "fact = Devices(testing.settings().host, SystemClock()).inspect('/dev/tty', open_it=True)\n"
        "print(fact.major, fact.minor, fact.openable, fact.reason)"
    )
    folder = Path(module.__file__).parents[2]
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        start_new_session=True,
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stdout.strip() == "5 0 False no driver or device answers behind it"


def test_a_file_whose_mode_denies_all_access_is_refused(terminal: str) -> None:
    """Decided by the mode bits alone, without opening."""
    os.chmod(terminal, 0)
    fact = probe().inspect(terminal, open_it=False)
    assert fact is not None and fact.openable is False


def test_existing_ports_are_listed(terminal: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Found by their names in the mounted /dev, and reported with the host's paths."""
    monkeypatch.setattr(module, "_PORTS", ("[0-9]*",))
    ports = probe("/dev/pts").serial_ports()
    assert f"/dev/{Path(terminal).name}" in [port.path for port in ports]
    assert all(port.character for port in ports)


def test_a_directory_with_the_name_of_a_port_is_not_listed(tmp_path: Path) -> None:
    """Docker creates such directories; they would mislead a user who searches for the device."""
    (tmp_path / "ttyACM0").mkdir()
    assert probe(tmp_path).serial_ports() == ()


def test_devices_are_found_by_patterns() -> None:
    """Character devices of this machine, each once and sorted; other files and folders are left out."""
    found = probe().matching(["/dev/nul?", "/dev/n*ll", "/dev/zero", "/dev/pts", "/dev/nothing/*"])
    assert [fact.path for fact in found] == ["/dev/null", "/dev/zero"]


@pytest.mark.parametrize("without", ["/dev/nul?", "/dev/by-id/usb-*"])
def test_devices_that_are_left_out_do_not_count_for_the_limit(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, without: str
) -> None:
    """Whether the pattern matches the device or a link to it."""
    monkeypatch.setattr(DeviceFact, "MAX_MATCHES", 1)
    for name in ("null", "zero"):
        (tmp_path / name).symlink_to(f"/proc/self/root/dev/{name}")  # a real device, outside of this /dev
    (tmp_path / "by-id").mkdir()
    (tmp_path / "by-id" / "usb-1").symlink_to("../null")
    found = probe(tmp_path).matching(["/dev/????"], without=[without])
    assert [Path(fact.path).name for fact in found] == ["zero"]


def test_broken_links_and_plain_files_are_no_devices(tmp_path: Path) -> None:
    """Also in folders such as /dev/serial/by-id."""
    (tmp_path / "by-id").mkdir()
    (tmp_path / "by-id" / "loop").symlink_to("loop")
    (tmp_path / "by-id" / "file").write_text("", encoding="ascii")
    assert not probe(tmp_path).matching(["/dev/by-id/*"])


def test_a_new_device_that_matches_is_reported(tmp_path: Path) -> None:
    """Its folder, too, may appear later."""
    changed = threading.Event()
    watcher = FileWatcher()
    made = Devices(
        testing.settings(host={"dev_root": str(tmp_path)}).host, SystemClock(), watcher, matching_changed=changed.set
    )
    made.matching(["/dev/serial/by-id/*"])
    changed.clear()
    (tmp_path / "serial" / "by-id").mkdir(parents=True)
    assert changed.wait(60.0)
    made.matching(["/dev/serial/by-id/*"])
    changed.clear()
    (tmp_path / "serial" / "by-id" / "usb-1").symlink_to("../../ttyUSB0")
    assert changed.wait(60.0)
    watcher.close()


def test_patterns_need_the_hosts_devices(tmp_path: Path) -> None:
    """Without the mount nothing is known."""
    with pytest.raises(CannotTell, match=r"host\.dev_root"):
        probe(tmp_path / "none").matching(["/dev/*"])
