"""`phm new-check` refuses what cannot become a check, and then writes nothing; tests/packaging installs what it writes."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from phm.cli import group
from phm.core.model import Slot
from phm.setup.new_check import NewCheck, UnusableName, render


def run(*words: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(group, ["new-check", *map(str, words)], prog_name="phm")
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.output


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("3d", "lower-case letters, digits and _"),
        ("photo-queue", "lower-case letters, digits and _"),
        ("PhotoQueue", "lower-case letters, digits and _"),
        ("größe", "lower-case letters, digits and _"),
        ("a\nb", "lower-case letters, digits and _"),
        ("../photo", "lower-case letters, digits and _"),
        ("class", "lower-case letters, digits and _"),
        ("none", "lower-case letters, digits and _"),
        ("_", "lower-case letters, digits and _"),
        ("a" * 25, "at most 24 characters"),
        ("nodes", "there is a check 'nodes' already"),
        ("checks", "there is a Python package phm_checks already"),
    ],
)
def test_a_name_that_cannot_be_used_is_refused(tmp_path: Path, name: str, reason: str) -> None:
    """The message says why, and no file is written."""
    code, text = run(name, "--into", tmp_path)
    assert code == 1 and reason in text
    assert list(tmp_path.iterdir()) == []


def test_existing_files_and_folders_are_never_written_to(tmp_path: Path) -> None:
    """A file, a folder and a link that leads nowhere stay unchanged."""
    (tmp_path / "one").write_text("mine")
    (tmp_path / "two").mkdir()
    (tmp_path / "three").symlink_to(tmp_path / "nowhere")
    for name in ("one", "two", "three"):
        code, text = run(name, "--into", tmp_path)
        assert code == 1 and "exists already" in text
    assert (tmp_path / "one").read_text() == "mine"
    assert list((tmp_path / "two").iterdir()) == [] and not (tmp_path / "nowhere").exists()


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    """The message has the path and the system's reason."""
    (tmp_path / "file").touch()
    code, text = run("photo", "--into", tmp_path / "file" / "below")
    assert code == 1 and str(tmp_path / "file") in text


@pytest.mark.parametrize("period", ["0", "0.01s", "25h", "soon", "-5s", "nan"])
def test_a_period_has_limits(tmp_path: Path, period: str) -> None:
    """The allowed values are in the message."""
    code, text = run("photo", "--into", tmp_path, f"--period={period}")
    assert code == 2 and "0.1s to 24h" in text
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("action", [False, True])
@pytest.mark.parametrize("slot", Slot)
def test_each_file_is_valid_python(slot: Slot, action: bool) -> None:
    """No placeholder is left, and each name of a slot is one of the interface."""
    texts = render(NewCheck("a_1_", slot, 0.1, action))
    assert f"api.Slot.{slot.name}" in texts["phm_a_1_/check.py"]
    for path, text in texts.items():
        assert "${" not in text
        if path.endswith(".py"):
            compile(text, path, "exec")


def test_the_longest_name_fits_the_line_of_the_operator() -> None:
    """`brief` of the sample has at most 38 characters with three digits."""
    text = render(NewCheck("a" * 24))[f"phm_{'a' * 24}/check.py"]
    (line,) = [line for line in text.splitlines() if "brief=" in line]
    assert len(line.split('"')[1].replace("{files}", "999")) <= 38
    with pytest.raises(UnusableName):
        NewCheck("a" * 25)
