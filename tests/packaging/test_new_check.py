"""`phm new-check` writes a package that can be installed, passes its tests and is found by PHM."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from tests.fakes import overlay

LIMIT_S = 300.0
pytestmark = pytest.mark.packaging


class Shell:
    """Runs commands in a new environment and a new folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._environment = overlay.make(folder / "environment")

    def run(self, *words: str, code: int = 0) -> str:
        """The output of a command that ends with `code`."""
        done = subprocess.run(
            words,
            cwd=self.folder,
            env=self._environment,
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
        assert done.returncode == code, f"{words} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}"
        assert "Traceback" not in done.stderr
        return done.stdout if code == 0 else done.stderr

    def checks(self) -> dict[str, Any]:
        return {entry["name"]: entry for entry in json.loads(self.run("phm", "checks", "--json"))}


@pytest.fixture(scope="module")
def shell(tmp_path_factory: pytest.TempPathFactory) -> Shell:
    return Shell(tmp_path_factory.mktemp("new_check"))


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "options", "files"),
    [
        ("photo_queue", [], {"check.py", "__init__.py"}),
        ("payload2", ["--action", "--slot", "15", "--period", "500ms"], {"check.py", "action.py", "__init__.py"}),
    ],
)
def test_the_package_passes_as_it_is_written(shell: Shell, name: str, options: list[str], files: set[str]) -> None:
    """Installed, its tests pass and `phm checks` lists it, with slot and period as asked for."""
    shell.run("phm", "new-check", name, *options)
    folder = shell.folder / name
    assert {path.name for path in (folder / f"phm_{name}").iterdir()} == files
    assert name not in shell.checks()
    shell.run("pip", "install", "--quiet", "-e", f"./{name}")
    text = shell.run("pytest", "-q", "-p", "no:cacheprovider", name)
    assert f"{7 if options else 4} passed" in text
    found = shell.checks()[name]
    assert (found["problem"], found["slot"]) == ("", 15 if options else 13)
    assert f"period_s = {0.5 if options else 5.0}\n" in (folder / f"phm_{name}" / "check.py").read_text()


def test_the_tests_of_the_package_test_it(shell: Shell) -> None:
    """A check that reports the limit too late does not pass the tests that come with it."""
    shell.run("phm", "new-check", "late")
    shell.run("pip", "install", "--quiet", "-e", "./late")
    path = shell.folder / "late" / "phm_late" / "check.py"
    path.write_text(path.read_text().replace("if count > LIMIT:", "if count > 10 * LIMIT:"))
    shell.run("pytest", "-q", "-p", "no:cacheprovider", "late", code=1)


def test_the_name_of_an_installed_check_is_refused(shell: Shell) -> None:
    """Also that of a check of another package."""
    shell.run("phm", "new-check", "taken")
    shell.run("pip", "install", "--quiet", "-e", "./taken")
    assert "there is a check 'taken' already" in shell.run("phm", "new-check", "taken", "--into", "x", code=1)
    assert not (shell.folder / "x").exists()
