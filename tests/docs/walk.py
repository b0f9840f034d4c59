"""Carries out a document: types its commands into a shell, writes its files, and compares what is shown.

A console block is a command (`$ ...`) and below it lines that its output must have, in this order. Times, durations, blanks
and the folder may differ. A command that only shows something is repeated until it shows this.
"""

from __future__ import annotations

import re
import subprocess
import textwrap
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, Queue

from tests.docs.blocks import FENCE, Block
from tests.docs.examples import ROOT
from tests.fakes.until import until

PAGE = ROOT / "docs" / "guides" / "write-a-check.md"
BEGIN, END = "<!-- walk: begin", "<!-- walk: end -->"
FOLDER = "/tmp/ten"
"""Of the reader, in the document; the walk has another."""
COMMAND_LIMIT_S, SHOWN_LIMIT_S = 300.0, 180.0
REPEATED = ("phm status", "phm faults", "grep ", "ls ", "phm checks")
"""What may be done again and again, and changes nothing."""
FILE = re.compile(r"`([\w./-]+\.(?:py|yaml))`")


@dataclass(frozen=True)
class Step:
    """A command with the lines that it shows, or a file (`path`) with its contents."""

    command: str = ""
    shown: tuple[str, ...] = ()
    path: str = ""
    contents: str = ""


def steps(text: str) -> list[Step]:
    """Those between the marks, in order. The file of a block is the last one named before it."""
    part = text[text.index(BEGIN) : text.index(END)]
    found: list[Step] = []
    for match in FENCE.finditer(part):
        contents = textwrap.dedent(match[3])
        if match[2] == "console":
            found += commands(contents)
        else:
            named = FILE.findall(part[: match.start()].rpartition("```")[2])
            assert named, f"no file is named before the block {contents[:60]!r}"
            found.append(Step(path=named[-1], contents=contents))
    return found


def commands(text: str) -> list[Step]:
    """Each typed command of a console block, with the lines below it."""
    found: list[Step] = []
    for line in text.splitlines():
        if line.startswith("$ "):
            found.append(Step(command=line[2:]))
        else:
            found[-1] = Step(found[-1].command, (*found[-1].shown, line))
    return found


def pattern(line: str, folder: Path) -> str:
    """A regular expression for a line of the document: times, durations and the width of blanks may differ."""
    words = line.strip().replace(FOLDER, str(folder)).split()
    return r"\s+".join(_volatile(word) for word in words)


def _volatile(word: str) -> str:
    time_of_day = re.fullmatch(r"[\d:.TZ-]*\d{2}:\d{2}:\d{2}[\d:.TZ-]*|\d{4}-\d{2}-\d{2}|\d+\.\d+s?", word)
    return r"\S+" if time_of_day else re.escape(word)


def walked(block: Block) -> bool:
    """Whether a block is carried out: it is of the page, between its marks."""
    text = PAGE.read_text("utf-8")
    first, last = (text.count("\n", 0, text.index(mark)) + 1 for mark in (BEGIN, END))
    return block.page == str(PAGE.relative_to(ROOT)) and first < block.line < last


class Shell:
    """One bash in which commands are typed: variables, the folder and jobs stay from one to the next."""

    def __init__(self, folder: Path, environment: Mapping[str, str]) -> None:
        self.folder = folder
        self._process = subprocess.Popen(
            ["bash", "--norc"],
            cwd=folder,
            env=dict(environment),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        self._lines: Queue[str] = Queue()
        threading.Thread(target=self._read, name="walk-shell", daemon=True).start()

    def do(self, step: Step) -> None:
        """Raises AssertionError when a command fails, or does not show what the document says."""
        if step.path:
            (self.folder / step.path).write_text(self._here(step.contents))
            return
        if not step.command.startswith(REPEATED):
            code, output = self.type(step.command)
            assert code == 0, f"$ {step.command}\n{output}"
            assert self._shows(step, output), f"$ {step.command}\n{output}\nis not\n" + "\n".join(step.shown)
            return
        last: list[object] = ["nothing"]

        def shown() -> bool:
            code, output = self.type(step.command)
            last[0] = f"\n$ {step.command}\n{output}"
            return code == 0 and self._shows(step, output)

        wanted = "the output of the document:\n" + "\n".join(step.shown)
        until(shown, wanted, lambda: last[0], limit_s=SHOWN_LIMIT_S)

    def type(self, command: str) -> tuple[int, str]:
        """Exit code and output."""
        mark = f"--done-{time.monotonic_ns()}"
        assert self._process.stdin is not None
        self._process.stdin.write(f"{self._here(command)}\necho {mark} $?\n")
        self._process.stdin.flush()
        lines: list[str] = []
        end = time.monotonic() + COMMAND_LIMIT_S
        while True:
            try:
                line = self._lines.get(timeout=max(0.0, end - time.monotonic()))
            except Empty:
                raise AssertionError(f"{command} takes more than {COMMAND_LIMIT_S:.0f} s: {lines}") from None
            if line.startswith(mark):
                return int(line.split()[1]), "\n".join(lines)
            lines.append(line.rstrip("\n"))

    def close(self) -> None:
        """End the shell and what it started in the background."""
        assert self._process.stdin is not None and self._process.stdout is not None
        if self._process.poll() is None:
            self._process.stdin.write("kill $(jobs -p) 2>/dev/null; wait; exit\n")
            self._process.stdin.close()
            self._process.wait(COMMAND_LIMIT_S)
        self._process.stdout.close()

    def _here(self, text: str) -> str:
        return text.replace(FOLDER, str(self.folder))

    def _shows(self, step: Step, output: str) -> bool:
        expected = r"[^\n]*\n(?:.*\n)*?[^\n]*".join(pattern(line, self.folder) for line in step.shown)
        return re.search(expected, output) is not None

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.put(line)
