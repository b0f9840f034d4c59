"""Writes the result of a soak into the project: its record, and the figures of docs/development/soak.md."""

from __future__ import annotations

import gzip
import json
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from sitl.campaign.publication import check_commit, compressed
from sitl.campaign.report import between_marks, markdown_rows, wrapped
from sitl.campaign.trial import Trial
from sitl.harness.compose_stack import ROOT
from sitl.soak import forecasts, report
from sitl.soak.sample import Sample, to_json

PAGE = Path("docs/development/soak.md")
RECORD = Path("docs/development/results/soak")
SAMPLES, RUNS, SETTING = "samples.jsonl.gz", "runs.jsonl.gz", "setting.json"
BEGIN, END = "<!-- soak: begin, written by scripts/soak --markdown -->", "<!-- soak: end -->"
DIGITS = 3
"""Milliseconds and kilobytes are enough."""


def publish(samples: Sequence[Sample], trials: Sequence[Trial], setting: dict[str, Any], root: Path = ROOT) -> None:
    """Write the record, and the figures that `--report-only` computes from it. Raises ValueError, and writes nothing, when the soak is
    incomplete or its commit is not in the history.
    """
    check_commit(str(setting.get("commit", "")), root)
    rounded = [_rounded(sample) for sample in samples]
    found = report.document(rounded, trials, setting)
    if not report.complete(found):
        raise ValueError(
            f"not published: {found['observed_s'] / 3600:.2f} of {setting['seconds'] / 3600:g} hours are observed. Call again to go on"
        )
    page = between_marks((root / PAGE).read_text("utf-8"), as_markdown(found, trials), BEGIN, END)
    folder = root / RECORD
    folder.mkdir(parents=True, exist_ok=True)
    lines = "".join(f"{to_json(sample)}\n" for sample in rounded)
    _write(folder / SAMPLES, gzip.compress(lines.encode("ascii"), mtime=0))
    _write(folder / RUNS, compressed(trials))
    _write(folder / SETTING, f"{json.dumps(setting, indent=2)}\n".encode())
    _write(root / PAGE, page.encode())


def as_markdown(found: dict[str, Any], trials: Sequence[Trial]) -> str:
    """The generated part of the page."""
    lines = [wrapped(each, "- ") for each in [*report.sentences(found), *found["alarms"]["listed"]]]
    lines += ["", *markdown_rows(report.HEAD, report.table(found)), "", "Forecasts:", ""]
    return "\n".join([*lines, *(wrapped(each, "- ") for each in forecasts.words(forecasts.backtest(trials)))])


def _rounded(sample: Sample) -> Sample:
    return replace(
        sample,
        mono=round(sample.mono, DIGITS),
        utc=round(sample.utc, DIGITS),
        resident_mb=round(sample.resident_mb, DIGITS),
        private_mb=round(sample.private_mb, DIGITS),
        cpu_s=round(sample.cpu_s, DIGITS),
    )


def _write(path: Path, content: bytes) -> None:
    """Replace the file, never leaving half of it."""
    new = path.with_name(f"{path.name}.new")
    new.write_bytes(content)
    os.replace(new, path)
