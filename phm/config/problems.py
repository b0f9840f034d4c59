"""Problems of a configuration: one `Problem` per mistake, all of them in one `ConfigError`."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass

Path = tuple[str | int, ...]
"""Position of a value in the tree: keys of mappings and indexes of lists, from the top."""

_SHOWN = 60
_LISTED = 20
_COMPARED = 500


@dataclass(frozen=True, slots=True)
class Problem:
    """One mistake in the configuration.

    file:    the file as it was named, or `environment NAME` for a variable.
    line:    counted from 1; 0 when it concerns no line.
    key:     e.g. `containers[0].files[1].path`; empty when it concerns no key.
    message: what is wrong, what is allowed, and what to do.
    """

    file: str
    line: int
    key: str
    message: str

    def __str__(self) -> str:
        place = f"{self.file}:{self.line}" if self.line else self.file
        parts = [place, self.key, self.message] if self.key else [place, self.message]
        return ": ".join(parts).encode("utf-8", "backslashreplace").decode()


class ConfigError(Exception):
    """The configuration is invalid. `problems` contains all of them, in order of lines."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        self.problems = tuple(sorted(dict.fromkeys(problems), key=lambda problem: (problem.line, problem.key)))
        super().__init__("\n".join(map(str, self.problems)))


def dotted(path: Path) -> str:
    """A path in dotted notation: `ros.topics[2].rate`."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            word = part if part and part.isprintable() and len(part) <= _SHOWN else shown(part)
            text += f".{word}" if text else word
    return text


def shown(value: object) -> str:
    """A value in a message: quoted, on one line, and never long."""
    text = repr(value)
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 4]}...{text[-1]}"


def listed(words: Iterable[str]) -> str:
    """`a, b, c`, cut after some."""
    found = list(words)
    rest = f" and {len(found) - _LISTED} more" if len(found) > _LISTED else ""
    return ", ".join(found[:_LISTED]) + rest if found else "none"


def suggestion(word: str, allowed: Iterable[str]) -> str:
    """`, did you mean 'x'?` when a word is close to an allowed one, else nothing."""
    candidates = list(allowed)[:_COMPARED]
    folded = {candidate.lower(): candidate for candidate in candidates}
    close = difflib.get_close_matches(word[:200].lower(), folded, n=1, cutoff=0.6)
    return f", did you mean '{folded[close[0]]}'?" if close else ""


def unknown(what: str, word: str, allowed: Iterable[str]) -> str:
    """`unknown check 'nods', did you mean 'nodes'? allowed: files, nodes`."""
    names = list(allowed)
    near = suggestion(word, names)
    return f"unknown {what} {shown(word)}{near or ','} allowed: {listed(names)}"
