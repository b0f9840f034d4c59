"""What a campaign writes into the project can be reproduced from its record."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import pytest

from sitl.campaign import publish
from sitl.campaign.main import main
from sitl.campaign.report import BEGIN, END, as_markdown
from sitl.campaign.show import left
from sitl.campaign.trial import Trial, append, load
from sitl.harness.compose_stack import ROOT
from tests.fakes.campaign_trials import T0, alarm, injection, trial

NUMBER = re.compile(r"\d+\.\d+|\d+")


def campaign() -> list[Trial]:
    """Two seeds with times of more digits than the record keeps."""
    setting = {"machine": "m", "day": "2026-01-01", "commit": "0123abc", "profile": "shipped", "load": "quiet"}
    return [
        trial(
            alarms=[alarm(0.4 + seed / 3, closed=T0 + 4.123456, outcome="resolved", by="restart")],
            injections=[injection(world=T0 + 3.98765)],
            setting={**setting, "seed": seed, "index": seed - 1, "planned": 1, "interval_s": 20.0, "autopilot": "sim"},
        )
        for seed in (1, 2)
    ]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A copy of the documents that a campaign writes."""
    for file in (publish.PAGE, publish.README):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / file, tmp_path / file)
    return tmp_path


def contents(root: Path) -> list[bytes]:
    return [(root / file).read_bytes() for file in (publish.RECORD, publish.PAGE, publish.README)]


def test_the_page_is_reproduced_from_the_record(root: Path) -> None:
    """Record, page and README are the same, byte for byte, when they are written from the written record."""
    publish.publish(campaign(), root)
    first = contents(root)
    publish.publish(load(root / publish.RECORD), root)
    assert contents(root) == first
    assert b"commit 0123abc" in first[1]
    assert b"0.90 s" in first[2], "mean detection of 0.73 s and 1.07 s"


def test_the_command_reproduces_the_page(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`--report-only` with the record of the page; from a record that is not compressed, too."""
    monkeypatch.setattr(publish.publish, "__defaults__", (root,))
    raw = root / "campaign.jsonl"
    for each in campaign():
        append(raw, each)
    assert main(["--report-only", "--record", str(raw), "--markdown"]) in (0, 1)
    first = contents(root)
    assert main(["--report-only", "--record", str(root / publish.RECORD), "--markdown"]) in (0, 1)
    assert contents(root) == first


def test_an_empty_record_changes_nothing(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A wrong `--record` must not replace the results by an empty page; the exit code says that trials are missing."""
    monkeypatch.setattr(publish.publish, "__defaults__", (root,))
    before = (root / publish.PAGE).read_bytes()
    assert main(["--report-only", "--record", str(root / "none.jsonl"), "--markdown"]) == 75
    assert (root / publish.PAGE).read_bytes() == before
    assert not (root / publish.RECORD).exists()


def test_planned_trials_that_are_missing_are_reported(root: Path) -> None:
    """Trials of a seed that was begun, and seeds that were not begun."""
    raw = root / "campaign.jsonl"
    for each in campaign():
        each.setting.update(planned=2, seeds=3)
        append(raw, each)
    assert left(load(raw)) == 1 + 1 + 2
    assert main(["--report-only", "--record", str(raw)]) == 75


def test_the_results_are_those_of_the_record() -> None:
    """The committed page and README are what the committed record gives; a page without a record says so, and then
    every figure of the README is on the page.
    """
    page, readme = (ROOT / publish.PAGE).read_text("utf-8"), (ROOT / publish.README).read_text("utf-8")
    written = page.partition(BEGIN)[2].partition(END)[0]
    figures = readme.partition(publish.BEGIN)[2].partition(publish.END)[0]
    assert written and figures
    if (ROOT / publish.RECORD).exists():
        trials = load(ROOT / publish.RECORD)
        assert written.strip("\n") == as_markdown(trials)
        assert figures.strip("\n") == publish.for_readme(trials)
    else:
        assert "Its raw record was not kept" in written
        assert set(NUMBER.findall(figures)) <= {*NUMBER.findall(written)}
