"""docs/guides/write-a-check.md takes a reader from nothing to a recovered fault: it is carried out here, command by command."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs import walk
from tests.docs.walk import PAGE, Shell, Step
from tests.fakes import overlay


@pytest.fixture
def shell(tmp_path: Path) -> Iterator[Shell]:
    """A shell in an empty folder, in an environment that has PHM, as after the first block of the page."""
    environment = overlay.make(tmp_path / "environment")
    (tmp_path / "ten").mkdir()
    made = Shell(tmp_path / "ten", {**environment, "COLUMNS": "200", "PYTHONDONTWRITEBYTECODE": "1"})
    yield made
    made.close()


@pytest.mark.packaging
@pytest.mark.long
def test_the_page_leads_to_a_recovered_fault(shell: Shell) -> None:
    """Each command succeeds and shows what the page says; alarm, action and proof are in the log."""
    found = walk.steps(PAGE.read_text("utf-8"))
    commands = [step.command for step in found]
    for needed in ("phm new-check", "pip install", "pytest", "phm run", "touch ", "phm faults", "kill"):
        assert any(needed in command for command in commands), f"the page no longer has {needed}"
    for step in found:
        shell.do(step)
    log = (shell.folder / "log" / "phm.log").read_text()
    for kind in ("FAILURE: (13)", "RESOLVED: (13)"):
        assert log.count(kind) == 1, log
    assert shell.type("wait; echo ended")[1].endswith("ended")


def test_a_file_is_the_one_that_is_named_last() -> None:
    """Commands and files come in the order of the page, and only those between the marks."""
    text = (
        "```console\n$ no\n```\n<!-- walk: begin -->\nSee `a.py`.\n```console\n$ one\nshown\n$ two\n```\n"
        "Not `b.py`, but `c/d.yaml`:\n\n```yaml\nkey: 1\n```\n<!-- walk: end -->\n```console\n$ no\n```\n"
    )
    assert walk.steps(text) == [Step("one", ("shown",)), Step("two"), Step(path="c/d.yaml", contents="key: 1\n")]


def test_only_numbers_that_differ_by_nature_may_differ(tmp_path: Path) -> None:
    """Times and durations may be others; counts and words may not."""
    environment = {"PATH": "/usr/bin:/bin"}
    shell = Shell(tmp_path, environment)
    try:
        shell.do(Step("echo '12:00:01.5 PHM: 12 photos in 0.31 s'", ("11:22:33 PHM:  12 photos in 0.05 s",)))
        shell.do(Step("echo $PWD/x; echo y", ("/tmp/ten/x", "y")))
        for wrong in (
            Step("echo 12", ("13",)),
            Step("echo a; echo b", ("b", "a")),
            Step("false"),
            Step("true", ("x",)),
        ):
            with pytest.raises(AssertionError):
                shell.do(wrong)
    finally:
        shell.close()
