"""Type `command`: the exit code of a program, as plug-ins of Nagios and Icinga end."""

from __future__ import annotations

import math
import re

from phm import api
from phm.api import Level
from phm_checks._custom.base import CustomCheck, Finding
from phm_checks._text import clean

_LEVELS = {0: Level.OK, 1: Level.WARN, 2: Level.ERROR}
MOST_VALUES = 16
# Labels are bounded, so that no text takes long to search.
_VALUE = re.compile(
    r"(?:'((?:[^']|''){1,100})'|([^\s=']{1,100}))=(-?\d{1,15}(?:\.\d{0,15})?(?:[eE][+-]?\d{1,3})?)([a-zA-Z%]{0,8})(?=[;\s]|$)\S*"
)
_UNITS = {"%": "percent"}


class Command(CustomCheck):
    """Runs the program; its first line is the text, its performance data are values."""

    def observe(self, world: api.World) -> Finding:
        entry = self.entry
        fact = world.programs.run(entry.command, timeout_s=entry.timeout, container=entry.container or "")
        line, data = split_output(fact.output)
        level = _LEVELS.get(fact.exit_code)
        if level is None:
            raise api.CannotTell(f"{self.subject}: exit code {fact.exit_code}: {clean(line) or 'no output'}")
        text = line or f"exit code {fact.exit_code}"
        return Finding(level, text, clean(line, 30) or f"exit code {fact.exit_code}", performance(data))


def split_output(output: str) -> tuple[str, str]:
    """The first line without performance data, and all performance data."""
    first, _, rest = output.strip().partition("\n")
    line, _, data = first.partition("|")
    return line.strip(), f"{data} {rest.partition('|')[2]}"


def performance(data: str) -> dict[str, api.Value]:
    """The values in `'label'=value[UOM];warn;crit;min;max ...` by label and unit; what is not of this form is left out."""
    found: dict[str, api.Value] = {}
    for match in _VALUE.finditer(data[:8192]):
        label, unit = clean((match[1] or match[2]).replace("''", "'"), 60), _UNITS.get(match[4], match[4])
        value = float(match[3])
        if label and math.isfinite(value) and len(found) < MOST_VALUES:
            found[f"{label}_{unit}" if unit else label] = value
    return found
