"""What validates settings takes 5 MB of memory, and the daemon needs it only while it reads its configuration."""

from __future__ import annotations

import threading
from collections.abc import Iterator

from phm.core.settings.base import Section

_PARTS = ("__pydantic_core_schema__", "__pydantic_validator__", "__pydantic_serializer__")
_lock = threading.Lock()
_forgotten: list[type[Section]] = []


def forget() -> None:
    """Free the validators of all sections. Settings that exist can be used as before; `restore` goes before new ones are made."""
    with _lock:
        for section in _sections(Section):
            if _PARTS[1] in vars(section):
                _forgotten.append(section)
                for part in _PARTS:
                    if part in vars(section):
                        delattr(section, part)


def restore() -> None:
    """Make validators again after `forget`; else nothing. Another thread that needs them waits until all are there."""
    with _lock:
        while _forgotten:
            _forgotten.pop().model_rebuild(force=True)


def _sections(base: type[Section]) -> Iterator[type[Section]]:
    for section in base.__subclasses__():
        yield section
        yield from _sections(section)
