"""What validates settings takes 5 MB of memory, and the daemon needs it only while it reads its configuration."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

from phm.core.settings.base import Section

_SCHEMA, *_PARTS = "__pydantic_core_schema__", "__pydantic_validator__", "__pydantic_serializer__"
_lock = threading.RLock()
_forgotten: list[type[Section]] = []


class _Absent:
    """In place of a validator or serializer: makes all of them again when it is used."""

    def __init__(self, section: type[Section], part: str) -> None:
        self._section, self._part = section, part

    def __getattr__(self, name: str) -> Any:
        restore()
        found = getattr(self._section, self._part)
        if isinstance(found, _Absent):
            raise AttributeError(name)
        return getattr(found, name)


def forget() -> None:
    """Free the validators of all sections. Settings that exist can be used as before; new ones can be made, after a moment."""
    with _lock:
        for section in _sections(Section):
            if section in _forgotten or not section.__pydantic_complete__:
                continue
            _forgotten.append(section)
            section.__pydantic_complete__ = False
            if _SCHEMA in vars(section):
                delattr(section, _SCHEMA)
            for part in _PARTS:
                setattr(section, part, _Absent(section, part))


def restore() -> None:
    """Make validators again after `forget`; else nothing. Another thread that needs them waits until all are there."""
    with _lock:
        while _forgotten:
            _forgotten.pop().model_rebuild(force=True)


def _sections(base: type[Section]) -> Iterator[type[Section]]:
    for section in base.__subclasses__():
        yield section
        yield from _sections(section)
