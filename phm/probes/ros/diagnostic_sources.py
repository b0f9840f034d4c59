"""Which publishers' statuses of one name count. Pure; times are in monotonic seconds.

diagnostic_updater leaves out the namespace of a node, so the statuses of two nodes or two agents may have the same name.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

MAX_SOURCES = 16
"""Sources of one name, those received last."""
STEADY_S = 3.0
"""A source that was received for a shorter time, such as a single `ros2 topic pub`, leaves nothing after this silence."""
_SEPARATOR = "\0"


@dataclass(frozen=True, slots=True)
class DiagnosticSource:
    """When a source was received for the first and the last time."""

    first_s: float
    last_s: float
    hardware_id: str = ""


def key_of(name: str, hardware_id: str, writer: bytes | None) -> str:
    """Identifies the source of a status. writer: identity of its publisher; None: unknown."""
    source = hashlib.blake2b(
        hardware_id.encode(errors="replace") + _SEPARATOR.encode() + (writer or b""), digest_size=8
    )
    return f"{name.replace(_SEPARATOR, '')}{_SEPARATOR}{source.hexdigest()}"


def name_of(key: str) -> str:
    return key.partition(_SEPARATOR)[0]


def newest(sources: Mapping[str, DiagnosticSource]) -> list[str]:
    """At most MAX_SOURCES keys, the one received last first."""
    return sorted(sources, key=lambda key: sources[key].last_s, reverse=True)[:MAX_SOURCES]


def counting(sources: Mapping[str, DiagnosticSource]) -> tuple[str, ...]:
    """The sources whose silence counts, of all that one name has; the one received last first."""
    if len(sources) == 1:
        return tuple(sources)
    keys = newest(sources)
    replaced = _replaced({key: sources[key] for key in keys})
    last_s = sources[keys[0]].last_s
    return tuple(key for key in keys if key not in replaced and not _passing(sources[key], last_s))


def _replaced(sources: Mapping[str, DiagnosticSource]) -> set[str]:
    """Sources that a new process has replaced: it began after their last message, or with it in one update, and continues. Each
    replaces only one, so that of two sources the silence of one remains when the other is restarted. One that is received again
    overlaps, and counts again."""
    replaced: set[str] = set()
    for new in sorted(sources.values(), key=lambda one: one.first_s):
        before = [key for key, old in sources.items() if _ended(old, new) and key not in replaced]
        if before:
            replaced.add(
                max(before, key=lambda key: (sources[key].hardware_id == new.hardware_id, sources[key].last_s))
            )
    return replaced


def _ended(old: DiagnosticSource, new: DiagnosticSource) -> bool:
    """Whether the older source ended before the new one began. The statuses of one update have the same time of reception."""
    return old.last_s <= new.first_s and old.last_s < new.last_s


def _passing(source: DiagnosticSource, now_s: float) -> bool:
    return source.last_s - source.first_s < STEADY_S < now_s - source.last_s
