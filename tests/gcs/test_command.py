"""`phm gcs` in its own process: output, exit codes, signals and errors."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import signal
import socket
import struct
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

import phm
from phm.wire import json_log
from tests.fakes.mavlink import Sender, free_port, heartbeat, text
from tests.fakes.until import until
from tests.gcs.bench import Wire

ROOT = Path(phm.__file__).parents[1]
KEY = bytes(range(1, 33))


_STARTED: list[subprocess.Popen[str]] = []


def run(*arguments: str) -> subprocess.Popen[str]:
    places = os.pathsep.join((str(ROOT), str(ROOT / "checks")))
    started = subprocess.Popen(
        [sys.executable, "-m", "phm.cli", "gcs", *arguments],
        env={**os.environ, "PYTHONPATH": places},
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )
    _STARTED.append(started)
    return started


@pytest.fixture(autouse=True)
def _end_processes() -> Iterator[None]:
    """A failing test leaves no process behind."""
    yield
    while _STARTED:
        started = _STARTED.pop()
        if started.poll() is None:
            started.kill()
        started.communicate()


@pytest.fixture
def agent_7() -> Iterator[tuple[int, Callable[[], None]]]:
    """A port for the program, and a function that sends as agent 7 that node_1 is dead."""
    port = free_port(socket.SOCK_DGRAM)
    wire, sender = Wire(port), Sender(7, 193)

    def speak() -> None:
        wire.send(sender.frame(heartbeat(0x40025D55)))
        wire.send(sender.frame(text("A07 FAIL 6 node_1 dead", 2)))

    yield port, speak
    wire.sock.close()


def test_the_command_prints_events_until_it_is_terminated(
    agent_7: tuple[int, Callable[[], None]], tmp_path: Path
) -> None:
    """JSON lines; SIGTERM ends it in order, with code 0 and a complete record."""
    port, speak = agent_7
    done = run(f"udpin:127.0.0.1:{port}", "--json", "--record", str(tmp_path / "r.jsonl"))
    lines: list[dict[str, Any]] = []
    assert done.stdout is not None
    while not any(line["event"] == "text" for line in lines):
        lines.append(json.loads(done.stdout.readline()))  # each line of the start arrives by itself
        if lines[-1]["event"] == "link":
            speak()
    assert [line["seq"] for line in lines] == list(range(1, len(lines) + 1))
    assert (lines[0]["event"], lines[-1]["brief"]) == ("start", "node_1 dead")
    done.send_signal(signal.SIGTERM)
    rest, errors = done.communicate(timeout=300)
    assert (done.returncode, errors) == (0, "")
    assert json.loads(rest.splitlines()[-1])["event"] == "end"
    recorded = [event["event"] for event in json_log.read(tmp_path / "r.jsonl")]
    assert recorded[-2:] == ["end", "snapshot"]


def test_without_a_terminal_events_are_lines_of_text(agent_7: tuple[int, Callable[[], None]]) -> None:
    """One line for each event, without a table."""
    port, speak = agent_7
    done = run(f"udpin:127.0.0.1:{port}")
    assert done.stdout is not None
    lines = done.stdout
    until(lambda: "is open" in lines.readline(), "the link")
    speak()
    until(lambda: lines.readline().endswith("CRITICAL A07 FAIL 6 node_1 dead\n"), "the line")
    done.send_signal(signal.SIGINT)
    assert done.communicate(timeout=300)[1] == ""
    assert done.returncode == 0


def test_a_terminal_gets_a_live_table(agent_7: tuple[int, Callable[[], None]]) -> None:
    """Redrawn in place; Ctrl-C restores the terminal."""
    port, speak = agent_7
    ours, theirs = os.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 80, 0, 0))
    # Only the terminal of the pty counts, not the environment of these tests.
    asked = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES", "NO_COLOR")}
    done = subprocess.Popen(
        [sys.executable, "-m", "phm.cli", "gcs", f"udpin:127.0.0.1:{port}"],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        env={**asked, "TERM": "xterm-256color", "PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "checks")))},
    )
    os.close(theirs)
    os.set_blocking(ours, False)
    shown = bytearray()

    def sees(words: bytes) -> bool:
        with contextlib.suppress(OSError):  # nothing new yet, or the program has ended
            shown.extend(os.read(ours, 65536))
        return words in shown

    until(lambda: sees(b"no agent received yet"), "the table")

    def row_shown() -> bool:
        speak()
        return sees(b"FAIL 6 node_1 dead")

    until(row_shown, "the row")
    assert b"\x1b[?1049h" in shown
    done.send_signal(signal.SIGINT)
    until(lambda: sees(b"\x1b[?1049l"), "the end")
    assert done.wait(120) == 0
    os.close(ours)


def test_the_exit_code_of_once_shows_whether_all_agents_are_ok(agent_7: tuple[int, Callable[[], None]]) -> None:
    """Without agents the exit code is 1; the snapshot of `--json` is one object."""
    port, _ = agent_7
    alone = run(f"udpin:127.0.0.1:{port}", "--once", "--for", "0.3", "--json", "--expect", "1-2")
    output, errors = alone.communicate(timeout=300)
    assert (alone.returncode, errors) == (1, "")
    whole = json.loads(output)
    assert [(one["name"], one["how"]) for one in whole["agents"]] == [("A01", "UNKNOWN"), ("A02", "UNKNOWN")]
    without_agents = run(f"udpin:127.0.0.1:{port}", "--once", "--for", "0.3")
    output, _ = without_agents.communicate(timeout=300)
    assert (without_agents.returncode, "no agent received yet" in output) == (1, True)


def test_a_bare_name_is_recorded_in_the_current_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`--record NAME` writes NAME where the program was started."""
    monkeypatch.chdir(tmp_path)
    done = run(f"udpin:127.0.0.1:{free_port(socket.SOCK_DGRAM)}", "--record", "flight.jsonl", "--for", "0.3")
    errors = done.communicate(timeout=300)[1]
    assert (done.returncode, errors) == (0, "")
    assert [event["event"] for event in json_log.read(tmp_path / "flight.jsonl")][-1] == "snapshot"


@pytest.mark.parametrize("more", [(), ("--json",), ("--once",), ("--once", "--json")])
def test_a_record_that_cannot_be_written_is_reported_without_a_terminal(tmp_path: Path, more: tuple[str, ...]) -> None:
    """On standard error, with the reason, and by exit code 1."""
    (tmp_path / "folder").write_text("a file in the way")
    path = str(tmp_path / "folder" / "flight.jsonl")
    done = run(f"udpin:127.0.0.1:{free_port(socket.SOCK_DGRAM)}", "--record", path, "--for", "1.5", *more)
    errors = done.communicate(timeout=300)[1]
    assert done.returncode == 1
    assert f"record: cannot write {path}: " in errors
    assert errors.count("record: ") <= 2, "once when it appears, once at the end"


def test_unread_output_does_not_delay_the_record(tmp_path: Path) -> None:
    """Recording continues, and one SIGTERM ends the program."""
    port, path = free_port(socket.SOCK_DGRAM), tmp_path / "r.jsonl"
    done = run(f"udpin:127.0.0.1:{port}", "--json", "--record", str(path))
    wire, senders = Wire(port), [Sender(number, 193) for number in range(1, 11)]
    until(path.exists, "the start")
    number = 0

    def speak() -> bool:
        nonlocal number
        number += 1
        for sender in senders:
            wire.send(sender.frame(text(f"{'x' * 40} {number}")))
        return path.stat().st_size > 300_000  # four times the capacity of a pipe

    until(speak, "the record")
    done.send_signal(signal.SIGTERM)
    assert done.wait(120) == 0
    done.communicate()
    wire.sock.close()


def test_a_port_in_use_is_one_sentence(tmp_path: Path) -> None:
    """Exit code 1 and what to do; the same for the port of `--serve`."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock, socket.create_server(("127.0.0.1", 0)) as server:
        sock.bind(("127.0.0.1", 0))
        taken = run(f"udpin:127.0.0.1:{sock.getsockname()[1]}")
        output, errors = taken.communicate(timeout=300)
        assert (taken.returncode, output, errors.count("\n")) == (1, "", 1)
        assert "Address already in use: another program listens there" in errors
        port = server.getsockname()[1]
        serving = run(f"udpin:127.0.0.1:{free_port(socket.SOCK_DGRAM)}", "--serve", str(port))
        _, errors = serving.communicate(timeout=300)
        assert (serving.returncode, errors) == (
            1,
            f"Error: --serve 127.0.0.1:{port}: Address already in use: another program listens there, choose another port "
            "with --serve\n",
        )


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("udp:127.0.0.1:1",), "is not a MAVLink endpoint: allowed are udpout:HOST:PORT"),
        (("udpin:127.0.0.1",), "needs a host and a port"),
        (("udpin://127.0.0.1:1",), "write udpin:HOST:PORT, without //"),
        (("/dev/ttyUSB0,57600",), "ends with a speed"),
        (("tcp:a:1", "tcp:a:1"), "given twice"),
        (("--id", "255"), "not in the range 251<=x<=254"),
        (("--expect", "1,x"), "ids are 1 to 250"),
        (("--expect", "8-5"), "ids are 1 to 250"),
        (("--serve", "here"), "needs a port"),
        (("--for", "0"), "x>0"),
    ],
)
def test_invalid_arguments_are_a_usage_error(arguments: tuple[str, ...], words: str) -> None:
    """Exit code 2, before anything is opened."""
    from click.testing import CliRunner

    from phm.cli import group

    result = CliRunner().invoke(group, ["gcs", *arguments])
    assert (result.exit_code, words in result.output) == (2, True), result.output


def test_a_key_that_others_can_read_is_rejected(tmp_path: Path) -> None:
    """As by the agents, with the name that the option has here."""
    from click.testing import CliRunner

    from phm.cli import group

    key = tmp_path / "key"
    key.write_text(KEY.hex())
    key.chmod(0o644)
    result = CliRunner().invoke(group, ["gcs", "--key", str(key)])
    assert (result.exit_code, "--key: " in result.output, "chmod 600" in result.output) == (2, True, True)
