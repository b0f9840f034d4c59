"""Results of checks that report what is not in the configuration."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase

from phm import api
from phm_checks._text import brief, listed

_LEVELS = {"warn": api.Level.WARN, "error": api.Level.ERROR}


def matches(text: str, patterns: Iterable[str]) -> bool:
    """Whether one of the patterns, with `*` and `?`, matches the entire text."""
    return any(fnmatchcase(text, pattern) for pattern in patterns)


def unexpected(
    found: Sequence[tuple[str, str]],
    *,
    level: str,
    noun: str,
    does: str,
    condition: str,
    remedy: str,
    most: int | None = None,
) -> api.Result:
    """One result for all that was found, with names and details from outside; the number of names is limited.

    level: `warn` or `error`. noun, does: such as `container` and `runs`. most: if so many were found, there may be more.
    """
    if not found:
        return api.ok(f"no unexpected {noun} {does}", values={"unexpected": 0})
    names = listed(f"{name} ({detail})" if detail else name for name, detail in found)
    first = found[0][0] if len(found) == 1 else f"{len(found)} {noun}s"
    if len(found) == most:
        names, first = f"{names} at least", f"{most}+ {noun}s"
    return api.Result(
        _LEVELS[level],
        f"{noun}s that are not in the configuration: {names}; {remedy}",
        brief(first, "unexpected"),
        condition,
        "",
        {"unexpected": len(found)},
    )
