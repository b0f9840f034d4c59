"""The documented configuration, examples, schema, Fast DDS profile and systemd unit, as installed with PHM."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]


def folder() -> Path | None:
    """In the wheel `phm/shipped`, which setup.py makes of config/; in the repository config/; None in an image."""
    places = (_PACKAGE / "shipped", _PACKAGE.parent / "config")
    return next((place for place in places if (place / "phm.schema.json").is_file()), None)
