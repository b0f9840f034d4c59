"""What is measured of one agent's PHM at one moment, and the file of all samples."""

from __future__ import annotations

import gzip
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, get_type_hints


@dataclass(frozen=True, slots=True)
class Sample:
    """mono, utc: seconds. run: changes when the daemon is started again. The memory in MB: resident, and what no other process shares.
    descriptors, threads: of the daemon and the processes it started. cpu_s, wakeups: totals since the measurement began; the CPU is that
    of the whole container. log_bytes: of all files in the log's folder."""

    mono: float
    utc: float
    agent: int
    run: str
    resident_mb: float
    private_mb: float
    descriptors: int
    threads: int
    cpu_s: float
    wakeups: int
    log_bytes: int


_TYPES = get_type_hints(Sample)


def to_json(sample: Sample) -> str:
    """One line, without its end."""
    return json.dumps(asdict(sample), allow_nan=False, separators=(",", ":"))


def from_json(line: str | bytes) -> Sample:
    """ValueError for anything but a sample."""
    data = json.loads(line)
    if not isinstance(data, dict):
        raise ValueError("not a sample")
    made: dict[str, Any] = {each.name: data.get(each.name) for each in fields(Sample)}
    for name, value in made.items():
        wanted = (int, float) if _TYPES[name] is float else _TYPES[name]
        if isinstance(value, bool) or not isinstance(value, wanted):
            raise ValueError(f"{name} of a sample is {value!r}, not a {_TYPES[name].__name__}")
    return Sample(**made)


def load(path: Path) -> list[Sample]:
    """All samples of a file (``.gz``: compressed), in its order. A line that was truncated by a kill is skipped; a missing file has none."""

    def known() -> Iterator[Sample]:
        with gzip.open(path, "rb") if path.suffix == ".gz" else path.open("rb") as stream:
            for line in stream:
                try:
                    yield from_json(line)
                except ValueError:
                    continue

    return list(known()) if path.exists() else []
