"""What a campaign writes into the project can be reproduced from its record."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from sitl.campaign import publication
from sitl.campaign.main import default_record, main
from sitl.campaign.progress import left
from sitl.campaign.report import BEGIN, END, as_markdown
from sitl.campaign.seeds import in_history, seed_of
from sitl.campaign.trial import Trial, append, load
from sitl.harness.compose_stack import ROOT
from tests.fakes.campaign_trials import T0, alarm, injection, trial

COMMIT = "0123456789" * 4
NUMBER = re.compile(r"\d+\.\d+|\d+")


def campaign() -> list[Trial]:
    """Two seeds with times of more digits than the record keeps."""
    setting = {"machine": "m", "day": "2026-01-01", "commit": COMMIT, "profile": "shipped", "load": "quiet"}
    return [
        trial(
            alarms=[alarm(0.4 + seed / 3, closed=T0 + 4.123456, outcome="resolved", by="restart")],
            injections=[injection(world=T0 + 3.98765)],
            setting={
                **setting,
                "seed": seed_of(COMMIT, seed - 1),
                "index": seed - 1,
                "planned": 1,
                "interval_s": 20.0,
                "autopilot": "sim",
            },
        )
        for seed in (1, 2)
    ]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A copy of the documents that a campaign writes."""
    for file in (publication.PAGE, publication.README):
        (tmp_path / file).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / file, tmp_path / file)
    return tmp_path


def contents(root: Path) -> list[bytes]:
    return [(root / file).read_bytes() for file in (publication.RECORD, publication.PAGE, publication.README)]


def test_the_page_is_reproduced_from_the_record(root: Path) -> None:
    """Record, page and README are the same, byte for byte, when they are written from the written record."""
    publication.publish(campaign(), root)
    first = contents(root)
    publication.publish(load(root / publication.RECORD), root)
    assert contents(root) == first
    assert f"commit {COMMIT}".encode() in first[1]
    assert b"0.90 s" in first[2], "mean detection of 0.73 s and 1.07 s"


def test_the_command_reproduces_the_page(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`--report-only` with the record of the page; from a record that is not compressed, too."""
    monkeypatch.setattr(publication.publish, "__defaults__", (root,))
    raw = root / "campaign.jsonl"
    for each in campaign():
        append(raw, each)
    assert main(["--report-only", "--record", str(raw), "--markdown"]) in (0, 1)
    first = contents(root)
    assert main(["--report-only", "--record", str(root / publication.RECORD), "--markdown"]) in (0, 1)
    assert contents(root) == first


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"seed": 7}, "a run of seed 7"),
        ({"index": 1}, "does not follow from the commit as seed 1"),
        ({"commit": f"{COMMIT}-dirty"}, "with changes that are in no commit"),
    ],
)
def test_a_record_whose_seeds_were_chosen_is_not_published(
    root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], change: dict[str, Any], error: str
) -> None:
    """Neither the documents nor the record are touched, also if a single run is not as it must be."""
    monkeypatch.setattr(publication.publish, "__defaults__", (root,))
    before, raw = (root / publication.PAGE).read_bytes(), root / "campaign.jsonl"
    first, second = campaign()
    first.setting.update(change)
    for each in (second, first):
        append(raw, each)
    assert main(["--report-only", "--record", str(raw), "--markdown"]) == 2
    assert error in capsys.readouterr().err
    assert (root / publication.PAGE).read_bytes() == before
    assert not (root / publication.RECORD).exists()


def test_a_record_of_a_commit_outside_the_history_is_not_published(root: Path) -> None:
    """It must be the commit of the working tree, or one before it. Without a repository this cannot be known."""

    def git(*argv: str) -> str:
        words = ["git", "-C", str(root), "-c", "user.name=n", "-c", "user.email=e@x", *argv]
        return subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()

    assert in_history(COMMIT, root)
    git("init", "-q", "-b", "main")
    git("commit", "-q", "--allow-empty", "-m", "one")
    one = git("rev-parse", "HEAD")
    git("commit", "-q", "--allow-empty", "-m", "two")
    two = git("rev-parse", "HEAD")
    assert in_history(one, root)
    assert in_history(two, root)
    git("checkout", "-q", one)
    assert not in_history(two, root)
    with pytest.raises(ValueError, match=f"{COMMIT}, which is not in the history"):
        publication.publish(campaign(), root)
    assert not (root / publication.RECORD).exists()


def test_a_seed_chosen_by_hand_has_a_separate_record(capsys: pytest.CaptureFixture[str]) -> None:
    """So a try does not enter the record of the campaign, and is not published."""
    assert default_record(COMMIT, None) == "campaign-01234567.jsonl"
    assert default_record(COMMIT, 7) == "campaign-01234567-seed-7.jsonl"
    assert main(["--seed", "7", "--commit", COMMIT, "--trials", "1", "--markdown"]) == 2
    assert "--seed 7 cannot be published" in capsys.readouterr().err
    assert main(["--commit", f"{COMMIT}-dirty", "--trials", "1", "--markdown"]) == 2, "said before the campaign"
    assert "with changes that are in no commit" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--keep", "--seed"])
def test_all_campaigns_reject_options_of_one(option: str) -> None:
    """A swarm that is kept cannot be used for the next profile; a seed that was chosen is not published."""
    done = subprocess.run([str(ROOT / "scripts/campaign"), "all", option], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert f"does not take {option}: " in done.stderr


def test_an_empty_record_changes_nothing(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A wrong `--record` must not replace the results by an empty page; the exit code says that trials are missing."""
    monkeypatch.setattr(publication.publish, "__defaults__", (root,))
    before = (root / publication.PAGE).read_bytes()
    assert main(["--report-only", "--record", str(root / "none.jsonl"), "--markdown"]) == 75
    assert (root / publication.PAGE).read_bytes() == before
    assert not (root / publication.RECORD).exists()


def test_planned_trials_that_are_missing_are_reported(root: Path) -> None:
    """Trials of a seed that was begun, and seeds that were not begun."""
    raw = root / "campaign.jsonl"
    for each in campaign():
        each.setting.update(planned=2, seeds=3)
        append(raw, each)
    assert left(load(raw)) == 1 + 1 + 2
    assert main(["--report-only", "--record", str(raw)]) == 75


def test_an_incomplete_campaign_is_published_as_one(
    root: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Only with `--incomplete`, and page and README say how much of it there is."""
    monkeypatch.setattr(publication.publish, "__defaults__", (root,))
    before, raw = (root / publication.PAGE).read_bytes(), root / "campaign.jsonl"
    for each in campaign():
        each.setting.update(planned=1, seeds=5)
        append(raw, each)
    asked = ["--report-only", "--record", str(raw), "--markdown"]
    assert main(asked) == 75
    assert "not written" in capsys.readouterr().out
    assert (root / publication.PAGE).read_bytes() == before
    assert not (root / publication.RECORD).exists()
    assert main([*asked, "--incomplete"]) == 75
    page, readme = ((root / file).read_text("utf-8") for file in (publication.PAGE, publication.README))
    note = "INCOMPLETE: 2 OF 5 TRIALS, 2 OF 5 SEEDS COMPLETE"
    assert note in " ".join(page.split())
    assert f"The campaign is {note.lower()}." in " ".join(readme.split())
    complete = campaign()
    assert "ncomplete" not in as_markdown(complete) + publication.for_readme(complete)


def test_the_results_are_those_of_the_record() -> None:
    """While no record is committed, page and README are written by hand: every figure of the README must be on the page,
    which says that its record was not kept. With a record, both must be exactly what it gives.
    """
    page, readme = (ROOT / publication.PAGE).read_text("utf-8"), (ROOT / publication.README).read_text("utf-8")
    written = page.partition(BEGIN)[2].partition(END)[0]
    figures = readme.partition(publication.BEGIN)[2].partition(publication.END)[0]
    assert written and figures
    if (ROOT / publication.RECORD).exists():
        trials = load(ROOT / publication.RECORD)
        assert written.strip("\n") == as_markdown(trials)
        assert figures.strip("\n") == publication.for_readme(trials)
    else:
        assert "Its raw record was not kept" in written
        assert set(NUMBER.findall(figures)) <= {*NUMBER.findall(written)}
