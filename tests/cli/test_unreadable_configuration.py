"""A configuration that PHM cannot read: exit code 78, after which systemd does not start the daemon again."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from phm.cli import group

READING = (
    ("run",),
    ("once",),
    ("validate",),
    ("checks", "--graph"),
    ("faults",),
    ("logs",),
    ("proxy-rules",),
    ("learn", "--for", "5s"),
)
"""The verbs that need the configuration."""


def without_permission(monkeypatch: pytest.MonkeyPatch, path: Path) -> None:
    """As for a user who may not read the file; root may, and tests may run as root."""
    access, opening = os.access, os.open

    def no_access(name: Any, mode: int, **more: Any) -> bool:
        return os.fspath(name) != str(path) and access(name, mode, **more)

    def no_open(name: Any, *words: Any, **more: Any) -> int:
        if name == path:
            raise PermissionError(13, "Permission denied", str(name))
        return opening(name, *words, **more)

    monkeypatch.setattr(os, "access", no_access)
    monkeypatch.setattr(os, "open", no_open)


def refused(result: Result, said: str) -> None:
    assert (result.exit_code, said in result.stderr) == (78, True), (result.exit_code, result.output)


@pytest.mark.parametrize("words", READING, ids=lambda words: str(words[0]))
def test_a_folder_is_not_a_configuration(words: tuple[str, ...], tmp_path: Path) -> None:
    """Docker makes a folder where the file of a bind mount is missing. The environment variable and -c are the same."""
    refused(CliRunner().invoke(group, [*words, "-c", str(tmp_path)]), "is a directory: name the file in it")
    refused(CliRunner().invoke(group, [*words], env={"PHM_CONFIG": str(tmp_path)}), "is a directory")


@pytest.mark.parametrize("words", READING, ids=lambda words: str(words[0]))
def test_a_file_that_may_not_be_read_is_not_a_configuration(
    words: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The sentence says what to change."""
    file = tmp_path / "phm.yaml"
    file.write_text("agent: {id: 1}\n")
    without_permission(monkeypatch, file)
    refused(CliRunner().invoke(group, [*words, "-c", str(file)]), "change its permissions")


def test_validate_reports_both_for_its_argument_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`phm validate FILE`."""
    refused(CliRunner().invoke(group, ["validate", str(tmp_path)]), "is a directory")
    file = tmp_path / "phm.yaml"
    file.write_text("agent: {id: 1}\n")
    without_permission(monkeypatch, file)
    refused(CliRunner().invoke(group, ["validate", str(file)]), "change its permissions")


def test_doctor_reports_a_folder_as_a_problem_of_the_configuration(tmp_path: Path) -> None:
    """It works without a configuration: its exit code says whether something is missing."""
    result = CliRunner().invoke(group, ["doctor", "--json", "-c", str(tmp_path)])
    assert (result.exit_code, "is a directory" in result.stdout) == (1, True), result.output
