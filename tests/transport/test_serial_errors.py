"""Line errors of a serial port, and its DTR line."""

from __future__ import annotations

import os
import pty
import sys
import termios

import pytest

from phm.transport import serial_errors
from phm.transport.serial_errors import SerialErrorCount


def test_a_port_keeps_its_dtr() -> None:
    """Closing it must not drop the line that resets the device; a port whose driver does not count reports nothing."""
    far, near = pty.openpty()
    attributes = termios.tcgetattr(near)
    attributes[2] |= termios.HUPCL
    termios.tcsetattr(near, termios.TCSANOW, attributes)
    serial_errors.keep_dtr(near)
    assert not termios.tcgetattr(near)[2] & termios.HUPCL
    assert serial_errors.read_counts(near) is None
    os.close(far)
    os.close(near)
    serial_errors.keep_dtr(near)  # a port that is gone raises nothing


def test_line_errors_are_read_in_the_layout_of_linux(monkeypatch: pytest.MonkeyPatch) -> None:
    """frame, overrun, parity and buf_overrun of struct serial_icounter_struct."""
    counters = bytearray(80)
    for at, value in ((6, 11), (7, 20), (8, 33), (10, 4)):
        counters[at * 4 : at * 4 + 4] = value.to_bytes(4, sys.byteorder)
    monkeypatch.setattr("phm.transport.serial_errors.fcntl.ioctl", lambda fd, request, data: bytes(counters))
    assert serial_errors.read_counts(0) == SerialErrorCount(framing=11, overrun=24, parity=33)
