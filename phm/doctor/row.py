"""One row of `phm doctor`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

State = Literal["ok", "limited", "missing"]


@dataclass(frozen=True, slots=True)
class Row:
    """What was looked at, and its result.

    state:  `ok`; `limited`: PHM works, but with less; `missing`: PHM cannot do its work here.
    remedy: what to do about it; empty for `ok`.
    """

    name: str
    state: State
    text: str
    remedy: str = ""


def ok(name: str, text: str) -> Row:
    return Row(name, "ok", text)


def limited(name: str, text: str, remedy: str) -> Row:
    return Row(name, "limited", text, remedy)


def missing(name: str, text: str, remedy: str) -> Row:
    """A row for something that PHM needs and cannot use. remedy: what to do."""
    return Row(name, "missing", text, remedy)
