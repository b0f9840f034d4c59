"""Keys of the live table."""

from __future__ import annotations

import os
import sys
import termios
import threading

import pytest

from phm.core.clock import SystemClock
from phm.gcs.keyboard import Keyboard, parse


@pytest.mark.parametrize(
    ("typed", "keys"),
    [
        ("", []),
        ("a", ["a"]),
        ("\x1b[A\x1b[B\x1bOA\x1bOB", ["up", "down", "up", "down"]),
        ("\r\n", ["enter", "enter"]),
        ("\x1b", ["escape"]),
        ("\x1b[5~\x1b[1;5Cq", ["q"]),
        ("\x00\x07é", ["é"]),
    ],
)
def test_keys_have_names(typed: str, keys: list[str]) -> None:
    """Several may arrive together; sequences of other keys are left out as a whole."""
    assert parse(typed) == keys


def test_a_terminal_is_read_key_by_key_and_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without waiting for Enter and without echo, until the end."""
    ours, theirs = os.openpty()
    with os.fdopen(theirs, "r") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        before = termios.tcgetattr(theirs)
        with Keyboard(SystemClock(), threading.Event()) as keyboard:
            assert keyboard.active
            assert keyboard.read(0.0) == []
            os.write(ours, b"\x1b[Bq")
            assert keyboard.read(60.0) == ["down", "q"]
            assert not termios.tcgetattr(theirs)[3] & termios.ICANON
        assert termios.tcgetattr(theirs) == before
    os.close(ours)


def test_a_pipe_has_no_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is typed into a pipe is not for the table, and waiting ends with the program."""
    ours, theirs = os.pipe()
    os.write(theirs, b"q")
    stop = threading.Event()
    stop.set()
    with os.fdopen(ours, "r") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        with Keyboard(SystemClock(), stop) as keyboard:
            assert (keyboard.active, keyboard.read(600.0)) == (False, [])
    os.close(theirs)
