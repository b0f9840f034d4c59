"""What a soak writes into the project can be reproduced from its record."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from sitl.campaign import seeds
from sitl.campaign.report import between_marks
from sitl.campaign.trial import NOMINAL, Trial
from sitl.harness.compose_stack import ROOT
from sitl.soak import publication, report
from sitl.soak.main import main
from sitl.soak.runner import load as load_runs
from sitl.soak.sample import Sample, load
from tests.fakes.campaign_trials import alarm

SETTING = {
    "seconds": 3600.0,
    "every_s": 600.0,
    "period_s": 10.0,
    "agents": 1,
    "seed": 1,
    "commit": "0123456789" * 4,
    "machine": "m",
    "profile": "shipped",
}


@pytest.fixture
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the page; its commit counts as one of the history."""
    (tmp_path / publication.PAGE).parent.mkdir(parents=True)
    shutil.copy(ROOT / publication.PAGE, tmp_path / publication.PAGE)
    monkeypatch.setattr(seeds, "in_history", lambda *_: True)
    monkeypatch.setattr(publication.publish, "__defaults__", (tmp_path,))
    return tmp_path


def samples() -> list[Sample]:
    """An hour of one agent, with more digits than the record keeps."""
    return [
        Sample(10 * at + 0.123456789, 1e9, 1, "1/7", 70.0 + at / 360, 60.0 + at / 720, 20, 9, at / 7, 5 * at, 1000)
        for at in range(360)
    ]


def runs(seconds: float = 3600.0) -> list[Trial]:
    return [Trial(NOMINAL, 0, 1, began=100.0, utc=0.0, ended=100.0 + seconds, alarms=[alarm(9.0, "nodes/x", agent=1)])]


def contents(root: Path) -> dict[str, bytes]:
    return {str(file.relative_to(root)): file.read_bytes() for file in sorted(root.rglob("*")) if file.is_file()}


def test_the_page_is_reproduced_from_the_record(root: Path) -> None:
    """The record and the page are the same, byte for byte, when they are written from the written record."""
    publication.publish(samples(), runs(), SETTING)
    first, folder = contents(root), root / publication.RECORD
    assert set(first) == {
        str(publication.PAGE),
        *(str(publication.RECORD / name) for name in (publication.SAMPLES, publication.RUNS, publication.SETTING)),
    }
    setting = json.loads((folder / publication.SETTING).read_text("utf-8"))
    publication.publish(load(folder / publication.SAMPLES), load_runs(folder / publication.RUNS), setting)
    assert contents(root) == first
    page = first[str(publication.PAGE)].decode()
    assert "1 false alarms in 1.00 agent hours" in page and "0 of 0 injected leaks" in page
    assert "| memory, private | 60.29 MB | +0.5 MB |" in page


def test_the_command_publishes_what_it_has_recorded(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the folder of a soak; afterwards from the published one as well."""
    folder = root / "soak"
    publication.publish(samples(), runs(), SETTING)
    shutil.copytree(root / publication.RECORD, folder)
    first = contents(root)
    assert main(["--report-only", "--markdown", "--out", str(folder)]) == 0, capsys.readouterr().err
    after = contents(root)
    assert {name: after[name] for name in first} == first


@pytest.mark.parametrize(
    ("changes", "seconds", "words"),
    [({}, 3000.0, "0.83 of 1 hours are observed"), ({"commit": "0123-dirty"}, 3600.0, "changes that are in no commit")],
)
def test_an_incomplete_soak_or_one_of_an_unknown_commit_is_not_published(
    root: Path, changes: dict[str, Any], seconds: float, words: str
) -> None:
    """Nothing is written."""
    before = contents(root)
    with pytest.raises(ValueError, match=words):
        publication.publish(samples(), runs(seconds), {**SETTING, **changes})
    assert contents(root) == before


def test_the_published_page_is_that_of_the_published_record() -> None:
    """No figure was edited by hand, and the rules that make them are those of today."""
    folder = ROOT / publication.RECORD
    setting = json.loads((folder / publication.SETTING).read_text("utf-8"))
    trials = load_runs(folder / publication.RUNS)
    found = report.document(load(folder / publication.SAMPLES), trials, setting)
    page = (ROOT / publication.PAGE).read_text("utf-8")
    assert page == between_marks(page, publication.as_markdown(found, trials), publication.BEGIN, publication.END)
