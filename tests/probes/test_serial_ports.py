"""Serial ports for own checks: real pseudo terminals, and real programs that use them."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from phm.core.clock import SystemClock
from phm.core.settings import HostSettings
from phm.facts import CannotTell, SerialFact
from phm.probes import serial_ports
from phm.probes.devices import Devices
from phm.probes.serial_ports import MAX_LINE, MOST_PORTS, LineMatcher, SerialPorts
from tests.fakes.until import until

HOLD = "import os, sys; fd = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY); print('open', flush=True); sys.stdin.read()"
LOCK = (
    "import serial, sys; port = serial.Serial(sys.argv[1], exclusive=True); print('open', flush=True); sys.stdin.read()"
)


class Device:
    """A serial device behind a link, as udev makes it in /dev/serial/by-id."""

    def __init__(self, folder: Path) -> None:
        self.near, self._far = os.openpty()
        tty.setraw(self._far)
        self.port, self.path = os.ttyname(self._far), str(folder / "gps")
        os.symlink(self.port, self.path)

    def release(self) -> None:
        """Leave the far end to PHM alone."""
        os.close(self._far)
        self._far = -1

    def send(self, data: bytes) -> None:
        os.write(self.near, data)

    def close(self) -> None:
        for fd in (self.near, self._far):
            if fd >= 0:
                os.close(fd)


@pytest.fixture
def device(tmp_path: Path) -> Iterator[Device]:
    made = Device(tmp_path)
    yield made
    made.close()


@pytest.fixture
def ports(monkeypatch: pytest.MonkeyPatch) -> Iterator[SerialPorts]:
    monkeypatch.setattr(serial_ports, "AGAIN_S", 0.05)
    monkeypatch.setattr(serial_ports, "USERS_S", 0.2)
    made = SerialPorts(SystemClock(), lambda path: Path(os.path.realpath(path)))
    yield made
    made.close()


def other(program: str, port: str) -> subprocess.Popen[bytes]:
    """Another program, which has the port open when this returns."""
    process = subprocess.Popen(
        [sys.executable, "-c", program, port], stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
    )
    assert process.stdout is not None and process.stdout.readline() == b"open\n"
    return process


def end(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
    assert process.stdin is not None and process.stdout is not None
    process.stdin.close()
    process.stdout.close()


def observe(ports: SerialPorts, device: Device, line: str = "") -> SerialFact:
    return ports.inspect(device.path, baud=57600, line=line)


def test_data_and_lines_are_seen(ports: SerialPorts, device: Device) -> None:
    """Any bytes are data; a line counts when it is complete and matches, however it was cut on the way."""
    until(lambda: observe(ports, device, "$GP*").problem == "", "the port to be open")
    assert observe(ports, device, "$GP*").data_s is None
    device.send(b"\xff\x00noise\r\n$GLGSV,1\r\n$GPG")
    until(lambda: observe(ports, device, "$GP*").data_s is not None, "data")
    assert observe(ports, device, "$GP*").line_s is None
    device.send(b"GA,1\r\n")
    until(lambda: observe(ports, device, "$GP*").line_s is not None, "a line")


def test_a_port_in_use_is_left_alone(ports: SerialPorts, device: Device) -> None:
    """It is named who has it, and its data stay for that program; PHM reads once it is free."""
    process = other(HOLD, device.port)
    try:
        found = until(lambda: "in use" in (fact := observe(ports, device)).problem and fact, "the user")
        assert f"python ({process.pid})" in found.problem.replace("python3", "python").replace("python.12", "python")
        device.send(b"for the other program\n")
        assert observe(ports, device).data_s is None
    finally:
        end(process)
    until(lambda: observe(ports, device).problem == "", "the port to be open")


def test_a_port_is_released_for_another_program(ports: SerialPorts, device: Device) -> None:
    """A program that opens it later does not share its data with PHM."""
    until(lambda: observe(ports, device).problem == "", "the port to be open")
    process = other(HOLD, device.port)
    try:
        until(lambda: "in use by" in observe(ports, device).problem, "the user")
    finally:
        end(process)


def test_a_locked_port_is_in_use(device: Device, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where the other program is in a container and its process cannot be seen."""
    monkeypatch.setattr(serial_ports, "AGAIN_S", 0.05)
    ports = SerialPorts(SystemClock(), lambda path: Path(os.path.realpath(path)), lambda path: ())
    process = other(LOCK, device.port)
    try:
        until(lambda: "another program has locked it" in observe(ports, device).problem, "the lock")
    finally:
        end(process)
        ports.close()


def test_a_device_that_is_unplugged_and_back_is_read_again(ports: SerialPorts, device: Device, tmp_path: Path) -> None:
    """The link then leads to another port."""
    device.release()
    until(lambda: observe(ports, device).problem == "", "the port to be open")
    os.close(device.near)
    device.near = -1
    os.unlink(device.path)
    until(lambda: observe(ports, device).problem, "the port to be gone")
    again = Device(tmp_path)
    try:
        until(lambda: observe(ports, device).problem == "", "the port to be open again")
        again.send(b"x")
        until(lambda: observe(ports, device).data_s is not None, "data")
    finally:
        again.close()


def test_the_number_of_ports_is_limited_and_their_threads_end(device: Device) -> None:
    """Each costs a thread."""
    ports = SerialPorts(SystemClock(), lambda path: Path("/nonexistent"), lambda path: ())
    names = [f"/dev/{number}" for number in range(MOST_PORTS)]

    def reasons() -> set[str]:
        return {ports.inspect(name, baud=9600, line="").problem for name in names}

    until(lambda: reasons() == {"no such file or directory"}, "the reason", reasons)
    with pytest.raises(CannotTell, match=f"no more than {MOST_PORTS} serial ports"):
        ports.inspect(device.path, baud=9600, line="")
    ports.close()
    until(lambda: not [thread for thread in threading.enumerate() if thread.name == "phm-serial"], "their end")


def test_a_stream_without_line_ends_takes_no_memory() -> None:
    """A device with the wrong baud rate sends any bytes for days."""
    lines = LineMatcher("ok*")
    for _ in range(50):
        assert not lines.add(b"\xfe" * 4096)
    assert len(lines._rest) <= MAX_LINE
    assert lines.add(b"\nok " + b"x" * 9000 + b"\n")


def test_a_pattern_with_many_stars_is_compared_quickly() -> None:
    """A hostile line must not stop PHM: time does not grow with the power of the stars."""
    lines = LineMatcher("*a" * 90 + "b")
    assert not lines.add((b"a" * 500 + b"\n") * 20)


def test_the_place_of_a_device_is_below_the_mount(tmp_path: Path) -> None:
    """Links are paths of the host."""
    (tmp_path / "ttyUSB3").touch()
    (tmp_path / "serial").mkdir()
    (tmp_path / "serial" / "gps").symlink_to("../ttyUSB3")
    devices = Devices(HostSettings(dev_root=str(tmp_path)), SystemClock())
    assert devices.place("/dev/serial/gps") == tmp_path / "ttyUSB3"
    (tmp_path / "serial" / "gone").symlink_to("../serial/gone")
    with pytest.raises(FileNotFoundError):
        devices.place("/dev/serial/gone")
