"""The command of a campaign without a swarm: its plan, its record and its seeds."""

from __future__ import annotations

import hashlib
import re
from typing import Any

import pytest

from sitl.campaign.arguments import parser
from sitl.campaign.main import main
from sitl.campaign.report import BEGIN, END
from sitl.campaign.schedule import schedule
from sitl.campaign.seeds import checked_out, seed_of
from sitl.campaign.trial import OFF as OFF_RUN, append
from sitl.harness.compose_stack import ROOT
from tests.fakes.campaign_trials import trial

COMMIT = "0123456789" * 4


def test_the_page_of_results_has_the_marks() -> None:
    """docs/development/results.md has each mark once, in order."""
    page = (ROOT / "docs" / "development" / "results.md").read_text("utf-8")
    assert page.count(BEGIN) == page.count(END) == 1
    assert page.index(BEGIN) < page.index(END)


def test_the_plan_is_printed_without_a_swarm(capsys: pytest.CaptureFixture[str]) -> None:
    """`--plan` needs no running swarm: the trials of each seed, how often each fault is injected, what is excluded and why.
    A wrong fault, number of seeds or commit ends with exit code 2.
    """
    assert main(["--plan", "--seeds", "2", "--trials", "3", "--commit", COMMIT]) == 0
    out = capsys.readouterr().out
    assert out.count("seed 1 of 2") == out.count("seed 2 of 2") == 1
    assert len([row for row in out.splitlines() if " on A0" in row]) == 6
    assert "6 trials, 2 with several faults on one agent" in out
    assert "memory_full: the shipped configuration does not set host.memory.error, host.memory.warn" in out
    assert main(["--plan", "--seeds", "1", "--trials", "1", "--only", "node_killed", "--commit", COMMIT]) == 0
    out = capsys.readouterr().out
    assert "memory_full: it is not among the faults given with --only" in out
    assert "-  node_killed" not in out
    for words, error in (
        (["--only", "nonsense"], "no such fault"),
        (["--seeds", "0"], "1 seed or more"),
        (["--commit", "abc"], "40 hexadecimal digits"),
    ):
        assert main(["--plan", *words]) == 2
        assert error in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "error"),
    [
        ({"commit": "f" * 40}, f"the record of commit {'f' * 40}"),
        ({"agents": 4}, "with other agents"),
        ({"seed": 1}, "another number of seeds or trials"),
    ],
)
def test_a_record_of_another_campaign_is_rejected(
    tmp_path: Any, capsys: pytest.CaptureFixture[str], change: dict[str, Any], error: str
) -> None:
    """Of another commit, with other settings, or with other trials than planned."""
    file = tmp_path / "trials.jsonl"
    words = ["--commit", COMMIT, "--seed", "1", "--trials", "4", "--record", str(file)]
    to_do = schedule(parser().parse_args(words))
    append(file, trial(kind=OFF_RUN, setting=to_do.setting(0)))
    append(file, trial(setting={**to_do.setting(0), **change}))
    assert main(words) == 2
    assert error in capsys.readouterr().err


def test_seeds_follow_from_the_commit() -> None:
    """By the documented rule, so that no one can choose them. Uncommitted changes do not change them."""
    for index in range(3):
        digest = hashlib.sha256(f"{COMMIT}/{index}".encode()).hexdigest()
        assert seed_of(COMMIT, index) == seed_of(f"{COMMIT}-dirty", index) == int(digest[:8], 16)
    assert re.fullmatch(r"[0-9a-f]{40}(-dirty)?", checked_out())
