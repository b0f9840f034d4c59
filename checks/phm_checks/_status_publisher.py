"""Which configured node publishes a status of /diagnostics: its message does not say so. Pure."""

from __future__ import annotations

import functools
import re

from phm import api
from phm_checks._ros_facts import full_name
from phm_checks._text import last


@functools.cache
def name_pattern(name: str) -> re.Pattern[str]:
    """Of an entry in `ros.diagnostics.watch`. Only `*` and `?` are special: `motor[0]: temperature` means itself."""
    parts = {"*": ".*", "?": "."}
    return re.compile("".join(parts.get(char, re.escape(char)) for char in name), re.DOTALL)


def named_publisher(name: str, settings: api.Settings) -> str:
    """The configured node that diagnostic_updater names before the colon; empty if not exactly one node matches."""
    before, colon, _ = name.partition(":")
    if not colon:
        return ""
    nodes = [full_name(node.name) for node in settings.ros.nodes]
    found = [node for node in nodes if node.lstrip("/") == before.lstrip("/")] or [
        n for n in nodes if last(n) == before
    ]
    return found[0] if len(found) == 1 else ""


def status_publisher(name: str, settings: api.Settings) -> str:
    """The node of the first entry in `watch` that has one and matches; otherwise as above."""
    for entry in settings.ros.diagnostics.watch:
        if entry.node and name_pattern(entry.name).fullmatch(name):
            return full_name(entry.node)
    return named_publisher(name, settings)
