"""Ground software of other projects as real processes, from the environment that `scripts/venv interop` creates."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import threading
from collections import deque
from pathlib import Path
from typing import Any

from tests.fakes.until import until

ROOT = Path(__file__).resolve().parents[2]
BIN = ROOT / ".venv-interop" / "bin"
END_LIMIT_S, KILL_LIMIT_S = 5.0, 60.0
KEPT = 20_000


class Program:
    """One process in its own process group, ended by `close`; `lines` has its output so far."""

    def __init__(self, words: list[str], folder: Path, python: Path = BIN / "python") -> None:
        assert python.exists(), f"there is no {python}: run scripts/venv interop"
        self.lines: deque[str] = deque(maxlen=KEPT)
        self._process = subprocess.Popen(
            [str(python), "-u", *words],
            cwd=folder,
            start_new_session=True,
            text=True,
            errors="replace",
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            env={"PATH": os.environ["PATH"], "HOME": str(folder), "TERM": "dumb"},
        )
        self._reader = threading.Thread(target=self._read, name="program", daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._process.stdout is not None
        with self._process.stdout as output:
            for line in output:
                self.lines.append(line.rstrip("\n"))

    def say(self, line: str) -> None:
        """Type a line."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{line}\n")
        self._process.stdin.flush()

    def printed(self, part: str) -> list[str]:
        """The lines so far with `part` in them."""
        return [line for line in list(self.lines) if part in line]

    def wait_for(self, part: str) -> str:
        """Wait for the first line that contains `part`, and return it."""
        found: list[str] = until(lambda: self.printed(part), f"a line with {part!r}", self.last_lines)
        return found[0]

    def last_lines(self) -> str:
        """The last lines, for a failure message."""
        return "\n".join(list(self.lines)[-30:])

    def close(self) -> None:
        """End the process group, with SIGKILL after a while. MAVProxy with a pipe as input ends only at the end of its input."""
        with contextlib.suppress(OSError, ValueError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        for number, limit_s in ((signal.SIGTERM, END_LIMIT_S), (signal.SIGKILL, KILL_LIMIT_S)):
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, number)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(limit_s)
        self._reader.join(KILL_LIMIT_S)


class Mavproxy(Program):
    """A MAVProxy without windows: a test types into it with `say`."""

    def __init__(self, folder: Path, *words: str) -> None:
        folder.mkdir()
        script = [str(BIN / "mavproxy.py"), "--state-basedir", str(folder)]
        super().__init__([*script, *words], folder)

    def texts(self) -> list[str]:
        """The STATUSTEXTs on its console so far."""
        return [line.partition("AP: ")[2] for line in self.printed("AP: ")]


class Watcher(Program):
    """MAVSDK in a process; `news` has what it received, as records with a `kind`."""

    def __init__(self, script: str, folder: Path, *urls: str) -> None:
        folder.mkdir()
        super().__init__([str(Path(__file__).with_name(script)), *urls], folder)

    def news(self, kind: str, **more: Any) -> list[dict[str, Any]]:
        """The records of a kind whose keys have these values."""
        records = [json.loads(line) for line in list(self.lines) if line.startswith("{")]
        return [
            record
            for record in records
            if record["kind"] == kind and all(record[key] == value for key, value in more.items())
        ]

    def wait_news(self, kind: str, **more: Any) -> dict[str, Any]:
        found: list[dict[str, Any]] = until(lambda: self.news(kind, **more), f"{kind} {more}", self.last_lines)
        return found[0]
