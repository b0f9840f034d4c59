"""`phm doctor` on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from phm.cli import group
from phm.doctor import examination, program
from phm.doctor.context import DoctorContext
from phm.doctor.row import Row

OK = Row("version", "ok", "PHM")
BAD = Row("socket", "missing", "no socket", "start it")


def invoke(monkeypatch: pytest.MonkeyPatch, rows: list[Row], *words: str) -> tuple[int, str, list[DoctorContext]]:
    """Exit code, output, and what was examined."""
    seen = []

    def examine(doctor_context: DoctorContext) -> dict[str, list[Row]]:
        seen.append(doctor_context)
        return {"phm": rows}

    monkeypatch.setattr(examination, "examine", examine)
    done = CliRunner().invoke(group, ["doctor", *words])
    return done.exit_code, done.output, seen


def test_a_missing_row_is_exit_code_1_and_shows_its_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    """A limited row is exit code 0."""
    code, output, _ = invoke(monkeypatch, [OK, BAD])
    assert code == 1 and "-> start it" in output
    assert invoke(monkeypatch, [OK, Row("x", "limited", "less", "do")])[0] == 0


def test_json_has_every_row(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each row has its group, name, state, text and remedy; one that is missing makes `ok` false."""
    code, output, _ = invoke(monkeypatch, [OK, BAD], "--json")
    document = json.loads(output)
    assert (code, document["ok"]) == (1, False)
    assert document["rows"][1] == {
        "group": "phm",
        "name": "socket",
        "state": "missing",
        "text": "no socket",
        "remedy": "start it",
    }


def test_doctor_works_without_and_with_a_broken_configuration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A broken one is named, and the defaults are examined."""
    monkeypatch.chdir(tmp_path)
    assert not invoke(monkeypatch, [OK])[2][0].problem
    (tmp_path / "phm.yaml").write_text("agent: {id: 0}\n")
    (broken,) = invoke(monkeypatch, [OK], "-c", "phm.yaml")[2]
    assert "agent.id" in broken.problem and not broken.configuration
    assert "`phm validate -c phm.yaml` lists every problem" in list(program.rows(broken))[1].remedy
    (tmp_path / "phm.yaml").write_text("agent: {id: 7}\n")
    (good,) = invoke(monkeypatch, [OK], "-c", "phm.yaml")[2]
    assert good.configuration == "phm.yaml" and good.settings.agent.id == 7
