"""Samples and runs on disk."""

from __future__ import annotations

from pathlib import Path

import pytest

from sitl.campaign.trial import to_json
from sitl.soak.runner import load as load_runs
from sitl.soak.sample import from_json, load, to_json as sample_to_json
from tests.fakes.soak_samples import quiet, sample


def test_samples_and_runs_are_read_as_written_and_torn_lines_are_skipped(tmp_path: Path) -> None:
    """A kill in the middle of a line loses that line alone."""
    file, runs = tmp_path / "samples.jsonl", tmp_path / "runs.jsonl"
    file.write_text(
        f"{sample_to_json(sample(1, 0.0))}\n" + '{"mono": 3, "ag\n' + sample_to_json(sample(2, 1.0)), "ascii"
    )
    assert load(file) == [sample(1, 0.0), sample(2, 1.0)]
    runs.write_text(f'{to_json(quiet(5))}\n{{"v"\n{to_json(quiet(6))}\n', "ascii")
    assert [each.seconds for each in load_runs(runs)] == [5, 6]
    assert load(tmp_path / "none") == [] and load_runs(tmp_path / "none") == []


@pytest.mark.parametrize(
    "line", ["7", "{", "{}", '{"mono": "x"}', sample_to_json(sample(1, 0)).replace('"1/7"', "null")]
)
def test_an_invalid_sample_is_rejected(line: str) -> None:
    """ValueError for any content."""
    with pytest.raises(ValueError):
        from_json(line)
