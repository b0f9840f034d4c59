"""Text from outside, made safe to print: one event stays one line, on disk and on a terminal."""

from __future__ import annotations


def one_line(text: str) -> str:
    """`text` with everything that could begin a separate line, hide, or steer a terminal, written as an escape.

    Names of containers, outputs of health checks and paths come from outside. Line breaks of every kind,
    escape sequences, direction overrides and invisible characters are not printable; they come out as
    ``\\n``, ``\\x1b``, ``\\u202e``. Printable text of any language is left alone.
    """
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode("ascii") for char in text)
