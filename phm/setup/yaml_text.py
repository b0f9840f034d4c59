"""Text from outside as a YAML scalar, so that a name can neither end its value nor be expanded."""

from __future__ import annotations

import math
import re

import yaml

_PLAIN = re.compile(r"[A-Za-z/][A-Za-z0-9_./-]*")
_WORDS = frozenset(["true", "false", "null", "yes", "no", "on", "off", "y", "n"])


def quoted(value: str) -> str:
    """For phm.yaml, where `${` begins a variable."""
    return _scalar(value.replace("${", "$${"))


def compose_quoted(value: str) -> str:
    """For a Compose file, where `$` begins a variable."""
    return _scalar(value.replace("$", "$$"))


def _scalar(value: str) -> str:
    """Plain where that is safe, else in double quotes on one line."""
    if _PLAIN.fullmatch(value) and value.lower() not in _WORDS:
        return value
    return str(yaml.safe_dump(value, default_style='"', width=math.inf, allow_unicode=True)).strip()
