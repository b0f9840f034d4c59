"""A real program in a pseudo terminal of a fixed size, and what it shows as SVG."""

from __future__ import annotations

import codecs
import contextlib
import fcntl
import io
import os
import pty
import re
import signal
import struct
import subprocess
import termios
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from rich.console import Console
from rich.terminal_theme import TerminalTheme
from rich.text import Text

from tests.fakes.until import until

HOME = "\x1b[H"
"""A live table begins each drawing with it."""
ROWS = 24
LIMIT_S = 60.0
FONT = re.compile(r"@font-face \{.*?\}\s*", re.DOTALL)
"""It would load a font from another server. Without it the viewer's monospace font is used, in the same cells."""
THEME = TerminalTheme(
    (22, 27, 34),
    (230, 237, 243),
    [
        (72, 79, 88),
        (248, 81, 73),
        (63, 185, 80),
        (227, 179, 65),
        (121, 192, 255),
        (210, 168, 255),
        (86, 212, 221),
        (230, 237, 243),
    ],
)


class Terminal:
    """Runs a program until `close`. Only its newest drawings are kept."""

    def __init__(
        self, words: Sequence[str], columns: int, rows: int = ROWS, environment: Mapping[str, str] | None = None
    ) -> None:
        self.columns = columns
        self._near, far = pty.openpty()
        fcntl.ioctl(far, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
        dropped = ("NO_COLOR", "FORCE_COLOR", "COLUMNS", "LINES", "COLORTERM")
        ours = {name: value for name, value in os.environ.items() if name not in dropped}
        self._process = subprocess.Popen(
            words,
            stdin=far,
            stdout=far,
            stderr=far,
            start_new_session=True,
            env={**ours, "TERM": "xterm-256color", **(environment or {})},
        )
        os.close(far)
        self._drawings = [""]
        self._thread = threading.Thread(target=self._read, name="test-terminal", daemon=True)
        self._thread.start()

    def _read(self) -> None:
        decoder = codecs.getincrementaldecoder("utf-8")()
        with contextlib.suppress(OSError):  # the program has ended
            while data := os.read(self._near, 65536):
                drawn = (self._drawings[-1] + decoder.decode(data)).split(HOME)
                self._drawings = [*self._drawings[:-1], *drawn][-3:]

    def screen(self) -> Text:
        """The last complete drawing of a live table."""
        drawings = self._drawings
        return _trimmed(drawings[-2] if len(drawings) > 1 else "")

    def output(self) -> Text:
        """Everything that a program printed which draws no live table, once it has ended."""
        until(lambda: self._process.poll() is not None, "the end of the program", limit_s=LIMIT_S)
        self._thread.join(LIMIT_S)
        return _trimmed("".join(self._drawings))

    def close(self) -> None:
        """Ctrl-C, and the end of the program."""
        self._process.send_signal(signal.SIGINT)
        try:
            self._process.wait(LIMIT_S)
        finally:
            self._process.kill()
            self._process.wait(LIMIT_S)
            self._thread.join(LIMIT_S)
            os.close(self._near)


@contextlib.contextmanager
def terminal(
    words: Sequence[str], columns: int, rows: int = ROWS, environment: Mapping[str, str] | None = None
) -> Iterator[Terminal]:
    """The program in a terminal, ended at the end of the block."""
    made = Terminal(words, columns, rows, environment)
    try:
        yield made
    finally:
        made.close()


def _trimmed(text: str) -> Text:
    """The styled text without blanks at the ends of lines, and without blank lines at its end."""
    lines = Text.from_ansi(text.replace("\r", "")).split("\n")
    for line in lines:
        line.rstrip()
    while lines and not lines[-1].plain:
        lines.pop()
    return Text("\n").join(lines)


def write_svg(path: Path, title: str, shown: Text, columns: int) -> None:
    """Draw the text as a window with this title."""
    console = Console(
        file=io.StringIO(),
        record=True,
        width=columns,
        force_terminal=True,
        color_system="truecolor",
        legacy_windows=False,
    )
    console.print(shown, crop=False, soft_wrap=True)
    console.print()  # the drawing cuts the lower part of its last line
    drawn = console.export_svg(title=title, theme=THEME, unique_id="phm")
    path.write_text("\n".join(line.rstrip() for line in FONT.sub("", drawn).splitlines()) + "\n", "utf-8")
