"""The command of a soak: its options, its record and its report."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sitl.campaign.trial import to_json
from sitl.soak.main import main
from sitl.soak.sample import to_json as sample_to_json
from tests.fakes.soak_samples import SETTING, quiet, samples


def test_the_report_is_made_again_from_the_record(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """--report-only writes page and document of an interrupted soak, and its exit code says that it is not complete."""
    taken = samples(lambda agent, at_s: 60 + at_s / 3600, hours=0.5)
    (tmp_path / "samples.jsonl").write_text("".join(f"{sample_to_json(each)}\n" for each in taken), "ascii")
    (tmp_path / "runs.jsonl").write_text(to_json(quiet(1800, agents=2)) + "\n", "ascii")
    (tmp_path / "setting.json").write_text(json.dumps(SETTING))
    assert main(["--report-only", "--json", "--out", str(tmp_path)]) == 75
    found = json.loads(capsys.readouterr().out)
    assert found == json.loads((tmp_path / "soak.json").read_text("utf-8"))
    slopes = {each["measurement"]: each["all"] for each in found["slopes"]}
    assert slopes["memory, private"]["slope"] == pytest.approx(1.0, rel=0.01)
    assert found["alarms"]["agent_hours"] == pytest.approx(1.0)
    page = (tmp_path / "soak.html").read_text("utf-8")
    assert "0 false alarms in 1.00 agent hours" in page and "NOT COMPLETE" in page and "unsafe-inline" not in page


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--report-only"], "has no record of a soak"),
        (["2", "--minutes", "5"], "not both"),
        (["0.001"], "allowed are 1 minute to 7 days"),
        (["1", "--period", "0"], "allowed are 1 to 600 s"),
        (["1", "--every", "90"], "allowed are 10 s"),
        (["1", "--agents", "99"], "allowed are 1 to"),
    ],
)
def test_invalid_options_are_refused_before_a_swarm_is_started(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    """With a sentence that says what is allowed, and exit code 2."""
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 2
    assert words in " ".join(capsys.readouterr().err.split())


def test_another_soak_is_not_continued_by_mistake(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The record says with which options it was begun."""
    (tmp_path / "setting.json").write_text(json.dumps(SETTING))
    assert main(["5", "--out", str(tmp_path)]) == 2
    assert "is the record of another soak" in " ".join(capsys.readouterr().err.split())
