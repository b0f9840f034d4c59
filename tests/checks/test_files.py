"""Slot 3: rules of the files check."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks.files import Files

PATH = "/app/critical_file"
SUM = "ab" * 32


def evaluate(
    *wanted: dict[str, Any], files: testing.FakeFiles, running: bool = True, mounts: tuple[api.Mount, ...] = ()
) -> api.Result:
    (check,) = Files.build(testing.settings(containers=[{"name": "ros_app", "files": list(wanted)}]))
    docker = testing.FakeDocker(*([testing.container("ros_app", mounts=mounts)] if running else []))
    result = check.run(testing.world(files=files, docker=docker))
    assert isinstance(result, api.Result)
    return result


def with_file(**fields: Any) -> testing.FakeFiles:
    files = testing.FakeFiles()
    files.put("ros_app", PATH, **fields)
    return files


def test_containers_without_files_have_no_unit() -> None:
    """There is nothing to check."""
    assert list(Files.build(testing.settings(containers=[{"name": "ros_app"}]))) == []


def test_expected_files_are_ok() -> None:
    """Present, executable, unmodified or absent as configured."""
    files = with_file(mode=0o755, executable=True, sha256=SUM)
    result = evaluate(
        {"path": PATH, "executable": True, "sha256": SUM.upper()}, {"path": "/app/core", "present": False}, files=files
    )
    assert result.level is api.Level.OK
    assert PATH in result.summary


@pytest.mark.parametrize(
    ("wanted", "fields", "condition", "brief"),
    [
        ({}, None, "file_missing", "critical_file missing"),
        ({"present": False}, {}, "file_unexpected", "critical_file unexpected"),
        ({"executable": True}, {}, "file_not_executable", "critical_file not executable"),
        ({"executable": True}, {"kind": "directory", "executable": True}, "file_not_executable", None),
        ({"sha256": SUM}, {"sha256": "cd" * 32}, "file_altered", "critical_file altered"),
        ({"sha256": SUM}, {"kind": "directory"}, "file_altered", "critical_file altered"),
    ],
)
def test_each_discrepancy_has_its_condition(
    wanted: dict[str, Any], fields: dict[str, Any] | None, condition: str, brief: str | None
) -> None:
    """One condition and one line report what is wrong with a file."""
    files = testing.FakeFiles() if fields is None else with_file(**fields)
    result = evaluate({"path": PATH, **wanted}, files=files)
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, condition, "ros_app")
    assert brief is None or result.brief == brief


def test_one_summary_lists_all_problems() -> None:
    """And the brief names all files with which the same is wrong."""
    result = evaluate({"path": "/a"}, {"path": PATH}, {"path": "/b"}, files=with_file())
    assert result.brief == "a b missing"
    assert "/a in" in result.summary and "/b in" in result.summary and PATH not in result.summary
    assert result.values["files_bad"] == 2


def test_a_restorable_file_comes_first() -> None:
    """Recovery acts on the first condition, and `path` selects the file."""
    result = evaluate(
        {"path": "/a", "executable": True},
        {"path": "/b", "restore": "image"},
        {"path": "/c"},
        files=testing.FakeFiles(),
    )
    assert (result.condition, result.evidence.file) == ("file_missing", "/b")
    assert "/a in" in result.summary and "/c in" in result.summary


def test_an_inaccessible_file_is_stale() -> None:
    """No access to a file does not prove that it is missing."""
    files = testing.FakeFiles()
    files.fail("the container is stopped and no volume covers the path")
    result = evaluate({"path": PATH}, files=files)
    assert result.level is api.Level.STALE
    assert "no volume covers" in result.summary


def test_a_file_without_its_container_is_stale() -> None:
    """A container that does not exist is one fault, not one per file."""
    assert evaluate({"path": PATH}, files=testing.FakeFiles(), running=False).level is api.Level.STALE


def test_a_known_problem_outweighs_an_inaccessible_file() -> None:
    """One unreadable file does not hide that another one is missing."""
    files = with_file()
    files.problems["ros_app", PATH] = api.CannotTell("permission denied")
    result = evaluate({"path": PATH}, {"path": "/gone"}, files=files)
    assert result.condition == "file_missing"
    assert "permission denied" in result.summary


def test_a_digest_that_could_not_be_read_is_stale() -> None:
    """A file without its digest may be modified."""
    assert evaluate({"path": PATH, "sha256": SUM}, files=with_file()).level is api.Level.STALE


@pytest.mark.parametrize(
    ("mount", "kind", "noted"),
    [
        (api.Mount("bind", "/home/pi/critical_file", PATH), "file", True),
        (api.Mount("bind", "/home/pi/critical_file", PATH), "directory", False),
        (api.Mount("bind", "/home/pi", "/app"), "file", False),
        (api.Mount("volume", "", PATH, "app_data"), "file", False),
    ],
)
def test_a_file_that_is_mounted_alone_is_noted(mount: api.Mount, kind: str, noted: bool) -> None:
    """The container keeps the file of its start when an editor or an update replaces it on the host, and PHM sees the new one."""
    result = evaluate({"path": PATH}, files=with_file(kind=kind), mounts=(mount,))
    assert result.level is api.Level.OK
    assert (f"{PATH} is mounted as a single file" in result.summary) is noted


def test_a_file_is_checked_while_its_mounts_are_unknown() -> None:
    """The engine may hang while a volume is read."""
    (check,) = Files.build(testing.settings(containers=[{"name": "ros_app", "files": [{"path": PATH}]}]))
    docker = testing.FakeDocker(testing.container("ros_app"))
    docker.fail("the engine does not answer")
    result = check.run(testing.world(files=with_file(), docker=docker))
    assert isinstance(result, api.Result)
    assert result.level is api.Level.OK
