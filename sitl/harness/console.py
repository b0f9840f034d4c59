"""Where the commands of this folder print what people read."""

from __future__ import annotations

import sys

from rich.console import Console

WIDTH = 132
"""Columns of what goes into a file or another program: by default rich would take 80, and break the tables."""


def make_console(*, json: bool) -> Console:
    """The terminal; with `json` its error stream, so that standard output is JSON alone."""
    console = Console(stderr=json)
    return console if console.is_terminal else Console(file=sys.stderr if json else sys.stdout, width=WIDTH)
