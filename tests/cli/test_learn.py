"""`phm learn` as a command: its options, and what it says when nothing can be learned."""

from __future__ import annotations

import errno
import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from phm.cli import group
from phm.facts import EndpointFact
from phm.learn import agent_observer, output
from phm.learn.baseline import Baseline
from phm.learn.observations import Observations, ObservedFolder, ObservedTopic

TYPE = "std_msgs/msg/String"
SEEN = Observations(
    60.0,
    nodes={"/a/lidar": True},
    topics=(ObservedTopic("/a/scan", (EndpointFact("/a/lidar", TYPE),), (), (10.0,) * 60),),
    problems=("containers were not watched: no engine",),
)


def invoke(*words: str) -> Result:
    return CliRunner().invoke(group, ["learn", *words], prog_name="phm")


@pytest.fixture(autouse=True)
def seen(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(agent_observer.AgentObserver, "run", lambda self: SEEN)
    monkeypatch.chdir(tmp_path)


def test_the_configuration_is_printed() -> None:
    """Without `-o` the result goes to stdout, with a note about what was not watched."""
    result = invoke("--fresh")
    assert result.exit_code == 0
    assert "rate: 10" in result.stdout and "containers were not watched" in result.stdout


@pytest.mark.parametrize(("unsure", "counted"), [([], 0), ([("ros.nodes /a/lidar", "looks generated")], 1)])
def test_what_was_not_watched_is_on_the_terminal(
    unsure: list[tuple[str, str]], counted: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Stdout is redirected to a file, whose last lines no one may read. Uncertain settings are counted where there are some."""
    monkeypatch.setattr(Baseline, "unsure", lambda self: unsure)
    stderr = invoke("--fresh").stderr
    assert "phm learn: containers were not watched: no engine\n" in stderr
    assert stderr.count("settings are uncertain") == counted


def test_a_file_is_updated_and_keeps_its_comments(tmp_path: Path) -> None:
    """What the user wrote stays, what was learned is added."""
    file = tmp_path / "phm.yaml"
    file.write_text("# mine\nagent: {id: 7}\n")
    assert invoke("-o", str(file)).exit_code == 0
    assert file.read_text().startswith("# mine\nagent: {id: 7}\n") and "/a/scan" in file.read_text()


def test_differences_are_printed_and_nothing_is_written(tmp_path: Path) -> None:
    """`--diff` prints what would change."""
    file = tmp_path / "phm.yaml"
    file.write_text("agent: {id: 7}\n")
    result = invoke("-c", str(file), "--diff")
    assert "+    - name: /a/scan" in result.stdout and " agent: {id: 7}" in result.stdout
    assert file.read_text() == "agent: {id: 7}\n"


def test_manifests_are_written_beside_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`--files` writes the sums of a container's folder."""
    folder = ObservedFolder("app", "/ws", {"a": "0" * 64}, 1)
    monkeypatch.setattr(
        agent_observer.AgentObserver, "run", lambda self: Observations(60.0, SEEN.containers, (folder,), SEEN.nodes)
    )
    assert invoke("--fresh", "--files", "app:/ws", "-o", str(tmp_path / "new" / "phm.yaml")).exit_code == 0
    assert "  a\n" in (tmp_path / "new" / "app-ws.sha256").read_text()


def test_json_lists_the_learned_names() -> None:
    """`--json` has the names, and whether the configuration would change."""
    document = json.loads(invoke("--fresh", "--json").stdout)
    assert (document["nodes"], document["topics"], document["changed"]) == (["/a/lidar"], ["/a/scan"], True)


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        (("--for", "soon"), "5s to 24h"),
        (("--for", "1s"), "5s to 24h"),
        (("--files", "app:/ws"), "--output"),
        (("--files", "app", "-o", "x"), "CONTAINER:/absolute/path"),
        (("--files", "app:/a/../b", "-o", "x"), "CONTAINER:/absolute/path"),
    ],
)
def test_invalid_options_are_refused_with_the_allowed_values(words: tuple[str, ...], problem: str) -> None:
    """With exit code 2."""
    result = invoke(*words)
    assert result.exit_code == 2 and problem in result.output


def test_an_invalid_configuration_is_refused_with_its_line(tmp_path: Path) -> None:
    """Exit code 78, before anything is observed."""
    (tmp_path / "phm.yaml").write_text("agent:\n  id: no\n")
    result = invoke("-c", "phm.yaml")
    assert result.exit_code == 78 and "phm.yaml:2: agent.id" in result.output


def test_nothing_learned_says_why(monkeypatch: pytest.MonkeyPatch) -> None:
    """The exit code is 1, and the problem of each probe is named."""
    monkeypatch.setattr(
        agent_observer.AgentObserver,
        "run",
        lambda self: Observations(60.0, problems=("ROS was not watched: no rclpy",)),
    )
    result = invoke("--fresh")
    assert result.exit_code == 1 and "no rclpy" in result.output


def test_a_file_is_kept_when_nothing_was_learned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The engine is down: an empty configuration must not replace the present one."""
    monkeypatch.setattr(agent_observer.AgentObserver, "run", lambda self: Observations(60.0))
    (tmp_path / "phm.yaml").write_text("agent: {id: 7} # mine\n")
    result = invoke("--fresh", "-o", "phm.yaml")
    assert result.exit_code == 1
    assert "nothing was learned" in result.output
    assert (tmp_path / "phm.yaml").read_text() == "agent: {id: 7} # mine\n"


def test_a_folder_that_cannot_be_written_is_found_before_the_measurement(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a container whose user does not own the folder that is mounted."""

    def refuse(*, prefix: str, dir: Path) -> None:
        raise PermissionError(errno.EACCES, "Permission denied", str(dir / prefix))

    measured: list[object] = []
    monkeypatch.setattr(agent_observer.AgentObserver, "run", measured.append)
    monkeypatch.setattr("tempfile.mkstemp", refuse)
    result = invoke("--fresh", "-o", "new/folder/phm.yaml")
    assert (result.exit_code, measured, result.stdout) == (1, [], "")
    assert "--output new/folder/phm.yaml: cannot write there (Permission denied)" in result.stderr
    assert '-u "$(id -u):$(id -g)"' in result.stderr


@pytest.mark.parametrize("name", ["phm.yaml", "new/folder/phm.yaml"])
def test_trying_the_output_leaves_nothing(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither a folder nor a file, if nothing is learned."""
    monkeypatch.setattr(agent_observer.AgentObserver, "run", lambda self: Observations(60.0))
    assert invoke("--fresh", "-o", name).exit_code == 1
    assert list(tmp_path.iterdir()) == []


def test_an_output_below_a_file_is_refused(tmp_path: Path) -> None:
    """No folder can be made there."""
    (tmp_path / "file").write_text("")
    result = invoke("--fresh", "-o", "file/phm.yaml")
    assert result.exit_code == 1 and "--output file/phm.yaml: cannot write there (Not a directory)" in result.stderr


@pytest.mark.parametrize("words", [(), ("--diff",), ("--json",)])
def test_what_cannot_be_written_after_the_measurement_is_printed(
    words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The measurement may have taken hours, and the disk may be full."""

    def fail(path: Path, data: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(output, "_replace", fail)
    result = invoke("--fresh", "-o", "phm.yaml", *words)
    printed = json.loads(result.stdout)["configuration"] if "--json" in words else result.stdout
    assert result.exit_code == 1 and printed.startswith("# Written by") and "rate: 10" in printed
    assert "phm.yaml was not written" in result.stderr and "No space left on device" in result.stderr
