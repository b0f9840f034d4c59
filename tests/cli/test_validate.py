"""`phm validate`: what it prints besides the problems of a file."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from phm.cli import group

CONFIG = Path(__file__).resolve().parents[2] / "config"


def test_schema_and_examples_are_printed() -> None:
    """In the repository they are those of config/."""
    schema = (CONFIG / "phm.schema.json").read_text("utf-8")
    assert CliRunner().invoke(group, ["validate", "--schema"]).stdout == schema
    assert CliRunner().invoke(group, ["validate", "--examples"]).stdout == f"{CONFIG}\n"


def test_without_examples_it_says_where_they_are(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Exit code 1."""
    monkeypatch.setattr("phm.config.shipped._PACKAGE", tmp_path / "phm")
    done = CliRunner().invoke(group, ["validate", "--examples"])
    assert done.exit_code == 1 and "part of the wheel and of the repository" in done.stderr
