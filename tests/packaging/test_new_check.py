"""`phm new-check` writes a package that can be installed, passes its tests and is found by PHM."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from tests.fakes import overlay

LIMIT_S = 300.0
pytestmark = pytest.mark.packaging


class Shell:
    """Runs commands in a new environment and a new folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        # Loading our plugins takes a third of the CPU time of a pytest.
        self._environment = {**overlay.make(folder / "environment"), "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}

    def run(self, *words: str, code: int = 0, **more: str) -> str:
        """The output of a command that ends with `code`; `more` are variables of its environment."""
        done = subprocess.run(
            words,
            cwd=self.folder,
            env={**self._environment, **more},
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
        assert done.returncode == code, f"{words} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}"
        assert "Traceback" not in done.stderr
        return done.stdout if code == 0 else done.stdout + done.stderr

    def checks(self) -> dict[str, Any]:
        return {entry["name"]: entry for entry in json.loads(self.run("phm", "checks", "--json"))}


NAMES = {
    "photo_queue": [],
    "payload2": ["--action", "--slot", "15", "--period", "500ms"],
}


class Installed(NamedTuple):
    """The packages of `NAMES`: the files of each module as written, and what `phm checks` listed before and after installation."""

    shell: Shell
    files: dict[str, set[str]]
    before: dict[str, Any]
    after: dict[str, Any]


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """All written, then installed as the README says, but by one pip: it starts and reads the environment once (1 s of CPU)."""
    shell = Shell(tmp_path_factory.mktemp("new_check"))
    for name, options in NAMES.items():
        shell.run("phm", "new-check", name, *options)
    files = {name: {path.name for path in (shell.folder / name / f"phm_{name}").iterdir()} for name in NAMES}
    before = shell.checks()
    words = [word for name in NAMES for word in ("-e", f"./{name}")]
    shell.run("pip", "install", "--quiet", "--no-warn-conflicts", *words)  # it only warns, about all other packages
    return Installed(shell, files, before, shell.checks())


@pytest.mark.parametrize(
    ("name", "files"),
    [("photo_queue", {"check.py", "__init__.py"}), ("payload2", {"check.py", "action.py", "__init__.py"})],
)
def test_the_package_passes_as_it_is_written(installed: Installed, name: str, files: set[str]) -> None:
    """Installed, its tests pass and `phm checks` lists it, with slot and period as asked for."""
    shell, options = installed.shell, NAMES[name]
    assert installed.files[name] == files
    assert name not in installed.before
    text = shell.run("pytest", "-q", "-p", "no:cacheprovider", name)
    assert f"{7 if options else 4} passed" in text
    found = installed.after[name]
    assert (found["problem"], found["slot"]) == ("", 15 if options else 13)
    assert f"period_s = {0.5 if options else 5.0}\n" in (shell.folder / name / f"phm_{name}" / "check.py").read_text()


def test_the_tests_of_the_package_test_it(installed: Installed, tmp_path: Path) -> None:
    """A check that reports the limit too late does not pass the tests that come with it."""
    late = tmp_path / "late"  # a copy, which is imported instead of what is installed
    shutil.copytree(installed.shell.folder / "photo_queue", late, ignore=shutil.ignore_patterns("__pycache__"))
    path = late / "phm_photo_queue" / "check.py"
    text = path.read_text()
    assert text.count("if count > LIMIT:") == 1
    path.write_text(text.replace("if count > LIMIT:", "if count > 10 * LIMIT:"))
    output = installed.shell.run("pytest", "-q", "-p", "no:cacheprovider", str(late), code=1, PYTHONPATH=str(late))
    assert "1 failed, 3 passed" in output


def test_the_name_of_an_installed_check_is_refused(installed: Installed) -> None:
    """Also that of a check of another package."""
    shell = installed.shell
    assert "there is a check 'photo_queue' already" in shell.run(
        "phm", "new-check", "photo_queue", "--into", "x", code=1
    )
    assert not (shell.folder / "x").exists()
