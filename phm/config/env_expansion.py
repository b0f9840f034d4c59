"""Expands `${NAME}` and `${NAME:-default}` in scalars, so that one file serves all agents of a swarm."""

from __future__ import annotations

import re
from collections.abc import Mapping

_PART = re.compile(r"(?P<escape>\$\$\{)|(?P<whole>\$\{(?P<body>[^}]*)(?P<end>\}?))")
_BODY = re.compile(r"(?P<name>[A-Za-z_][A-Za-z0-9_]*)(?::-(?P<default>.*))?", re.DOTALL)
# Limits the growth of a small file that repeats a long variable.
LONGEST = 1 << 20


class ExpandError(ValueError):
    """A variable that cannot be expanded; the text is the message for the user."""


class Expander:
    """Expands from one environment; as in a shell, an empty variable takes the default too.

    Values are not expanded again: a `${` in a variable's value remains. All expanded text together is
    at most `LONGEST` characters.
    """

    def __init__(self, environ: Mapping[str, str]) -> None:
        self._environ = environ
        self._left = LONGEST

    def expand(self, text: str) -> str:
        """`text` with its variables replaced. Raises `ExpandError`."""
        if "${" not in text:
            return text
        pieces, end = [], 0
        for match in _PART.finditer(text):
            pieces += [text[end : match.start()], "${" if match["escape"] else self._value(match)]
            end = match.end()
        result = "".join([*pieces, text[end:]])
        self._spend(len(result))
        return result

    def _value(self, match: re.Match[str]) -> str:
        body = _BODY.fullmatch(match["body"])
        if not match["end"]:
            raise ExpandError("'${' is never closed: write ${NAME} or ${NAME:-default} ($${ for a literal ${)")
        if body is None:
            allowed = "allowed are ${NAME} and ${NAME:-default} ($${ for a literal ${)"
            raise ExpandError(f"{match['whole'][:60]!r} is not a variable, {allowed}")
        name, default = body["name"], body["default"]
        if default is not None and "${" in default:
            raise ExpandError(f"the default of ${{{name}}} contains another variable, only plain text is allowed")
        value = self._environ.get(name)
        if value or (value is not None and default is None):
            self._spend(len(value))
            return value
        if default is None:
            raise ExpandError(f"${{{name}}} is not set: set {name}, or write ${{{name}:-default}}")
        return default

    def _spend(self, characters: int) -> None:
        self._left -= characters
        if self._left < 0:
            raise ExpandError(
                f"the file exceeds {LONGEST} characters after expansion of its variables: use shorter values"
            )
