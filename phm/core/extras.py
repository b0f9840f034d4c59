"""How messages name an optional dependency of PHM."""

from __future__ import annotations


def remedy(extra: str) -> str:
    """How to install an extra of pyproject.toml: from a clone, as PHM is in no package index."""
    return f"install the extra '{extra}' (in a clone of PHM: pip install '.[{extra}]')"
