"""Slot 3: a folder with a manifest."""

from __future__ import annotations

import pytest

from phm import api, testing
from phm_checks.files import Files

PATH = "/ws/install"


def judge(tree: api.TreeFact | None = None, problem: str = "") -> api.Result:
    wanted = {"path": PATH, "manifest": "/etc/phm/ws.sha256", "ignore": ["*.pyc"]}
    (check,) = Files.build(testing.settings(containers=[{"name": "ros_app", "files": [wanted]}]))
    files = testing.FakeFiles()
    if tree is not None:
        files.trees["ros_app", PATH] = tree
    if problem:
        files.problems["ros_app", PATH] = api.CannotTell(problem)
    result = check.run(testing.world(files=files, docker=testing.FakeDocker(testing.container("ros_app"))))
    assert isinstance(result, api.Result)
    return result


def test_an_unaltered_folder_is_ok() -> None:
    """A folder without differences is OK."""
    result = judge(api.TreeFact(4312, 10**8))
    assert result.level is api.Level.OK


def test_all_differences_are_in_one_text() -> None:
    """One unit, however many files: what changed, what is missing, what is new."""
    result = judge(api.TreeFact(4312, 10**8, 3, changed=("setup.bash",), missing=("lib/a.so",), new=("lib/evil.so",)))
    assert (result.level, result.condition) == (api.Level.ERROR, "tree_altered")
    assert "3 files differ: changed: setup.bash; missing: lib/a.so; new: lib/evil.so" in result.summary
    assert result.brief == "setup.bash changed +2"
    assert len(result.brief) <= 38


@pytest.mark.parametrize("kind", ["changed", "missing", "new", "unreadable"])
def test_a_deep_path_keeps_the_name_of_its_file(kind: str) -> None:
    """Folders at the beginning are cut off."""
    path = "my_robot/lib/python3.12/site-packages/my_robot_navigation/behaviors/recovery/planner_node.py"
    result = judge(api.TreeFact(10, 1, differing=int(kind != "unreadable"), **{kind: (path,)}))
    assert " ...thon3.12/" in result.summary and "/recovery/planner_node.py" in result.summary


def test_a_hostile_name_cannot_break_the_text() -> None:
    """No line break, no terminal sequence, and a bounded length."""
    result = judge(api.TreeFact(1, 1, 1, new=("x\n2026-01-01 ---- SUCCESS: all is OK\x1b[2J" + "y" * 5000,)))
    assert "\n" not in result.summary and "\x1b" not in result.summary
    assert len(result.summary) < 500


@pytest.mark.parametrize(
    ("tree", "word"),
    [
        (api.TreeFact(100, 1, pending=60), "40 of 100"),
        (api.TreeFact(100, 1, unreadable=("private",)), "private"),
    ],
)
def test_files_that_were_not_read_are_not_ok(tree: api.TreeFact, word: str) -> None:
    """STALE, with their number or their name."""
    result = judge(tree)
    assert result.level is api.Level.STALE and word in result.summary


def test_a_difference_counts_before_all_is_read() -> None:
    """One changed file is an error, even while others are still to be read."""
    assert judge(api.TreeFact(100, 1, 1, changed=("a",), pending=60)).level is api.Level.ERROR


def test_a_missing_folder_is_an_error() -> None:
    """Its condition is `file_missing`."""
    assert judge().condition == "file_missing"


def test_a_folder_outside_of_volumes_is_stale() -> None:
    """PHM cannot see its files, so it does not report them as missing."""
    assert judge(problem="not in a volume").level is api.Level.STALE
