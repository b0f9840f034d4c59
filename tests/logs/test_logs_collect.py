"""`phm logs collect` with a Docker Engine on a real socket, and logs that the log reporter writes and rotates meanwhile."""

from __future__ import annotations

import gzip
import json
import os
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from phm.cli import group
from phm.logs.copies import Copies, Fetched, key_of
from phm.logs.log_collection import Collection
from tests.fakes.engine import FakeEngine, container
from tests.fakes.log_agents import PLACE, Agent, agent as agent, collect, copies, engine as engine, texts


def test_a_report_reads_the_logs_of_eight_containers(tmp_path: Path, engine: FakeEngine) -> None:
    """Each agent has a folder with its name; containers without a log are no problem."""
    for number in range(1, 9):
        made = Agent(tmp_path / "in" / str(number), number)
        made.write(2)
        made.log.close()
        engine.containers[f"swarm-{number}"] = container(f"swarm-{number}", folders={PLACE: made.folder})
        engine.containers[f"app-{number}"] = container(f"app-{number}")
    out = tmp_path / "out"
    result = collect(out, "--json", engine=engine)
    assert result.exit_code == 0, result.output
    said = json.loads(result.output)
    assert said["missing"] == [] and len(said["logs"]) == 8
    assert {one["agent"] for one in said["logs"]} == {f"agent_{number}" for number in range(1, 9)}
    for number in range(1, 9):
        assert (out / f"agent_{number}" / "phm.log").read_bytes() == (tmp_path / f"in/{number}/phm.log").read_bytes()
    report = CliRunner().invoke(group, ["report", str(out), "--json"])
    assert report.exit_code == 0, report.output
    assert {one["agent"] for one in json.loads(report.output)["agents"]} == {
        f"agent_{number}" for number in range(1, 9)
    }
    shown = CliRunner().invoke(group, ["logs", str(out), "--json"])
    assert shown.output.count('"note"') == 16


def test_the_next_run_fetches_only_what_changed(tmp_path: Path, engine: FakeEngine, agent: Agent) -> None:
    """Without a change it copies no file; after a new line the files that are written, and not the rotated one."""
    out = tmp_path / "out"
    agent.rotate()
    assert collect(out, engine=engine).exit_code == 0
    engine.calls.clear()
    result = collect(out, engine=engine)
    assert result.exit_code == 0 and copies(engine) == 0, result.output
    assert "0 files fetched" in result.output
    agent.write()
    assert collect(out, engine=engine).exit_code == 0
    assert copies(engine) == 2
    assert texts(out / "agent_1") == list(range(1, agent.count + 1))


def test_files_that_the_agent_has_removed_are_kept(tmp_path: Path, engine: FakeEngine, agent: Agent) -> None:
    """Runs at any distance give one record in order, under the names of rotated files."""
    out = tmp_path / "out"
    for _ in range(3):
        for _ in range(2):
            agent.rotate()
        agent.write(2)
        assert collect(out, engine=engine).exit_code == 0
        for _ in range(9):
            agent.rotate()
        assert collect(out, engine=engine).exit_code == 0
    kept = texts(out / "agent_1")
    assert kept == list(range(1, agent.count + 1))
    assert len(texts(agent.folder)) < len(kept), "the agent has removed nothing: the test shows nothing"
    names = {path.name for path in (out / "agent_1").iterdir() if ".jsonl" in path.name}
    assert names == {"phm.jsonl", *(f"phm.jsonl.{number}.gz" for number in range(1, len(names)))}


def test_a_file_that_rotates_during_the_copy_is_not_lost(tmp_path: Path, engine: FakeEngine, agent: Agent) -> None:
    """Between the list and the copy, and between two copies; what was copied under a wrong name is recognized."""
    out = tmp_path / "out"
    turns: list[str] = []

    def rotate(method: str, name: str) -> None:
        if method == "GET" and name.startswith("phm.jsonl") and len(turns) < 4:
            turns.append(name)
            agent.rotate()

    agent.rotate()
    engine.archived = rotate
    result = collect(out, engine=engine)
    assert result.exit_code == 0, result.output
    assert len(turns) == 4
    assert texts(out / "agent_1") == list(range(1, agent.count + 1))


def test_a_file_that_is_compressed_while_it_is_looked_for_is_not_lost(
    tmp_path: Path, engine: FakeEngine, agent: Agent
) -> None:
    """Between the look at its compressed copy, which is not there yet, and the look at the file itself."""
    agent.rotate()
    agent.rotate()
    agent.log.close()
    plain, packed = agent.folder / "phm.jsonl.2", agent.folder / "phm.jsonl.2.gz"
    content = packed.read_bytes()
    packed.unlink()
    plain.write_bytes(gzip.decompress(content))

    def compress(method: str, name: str) -> None:
        if name == plain.name and plain.exists():
            packed.write_bytes(content)
            plain.unlink()

    engine.archived = compress
    assert collect(tmp_path / "out", engine=engine).exit_code == 0
    assert packed.exists() and texts(tmp_path / "out" / "agent_1") == list(range(1, agent.count + 1))


def test_a_log_that_rotates_at_each_copy_says_so(tmp_path: Path, engine: FakeEngine, agent: Agent) -> None:
    """It does not go on forever, and does not claim to be complete."""
    engine.archived = lambda method, name: agent.rotate() if method == "GET" and ".jsonl" in name else None
    result = collect(tmp_path / "out", engine=engine)
    assert result.exit_code == 1 and "rotated faster than it can be copied" in result.output


def test_agents_with_one_name_have_two_folders(tmp_path: Path, engine: FakeEngine) -> None:
    """With the id of the second; also if that is the same."""
    for number, one in enumerate((1, 2, 2)):
        made = Agent(tmp_path / "in" / str(number), one, "uav")
        made.write(number + 1)
        made.log.close()
        lines = (made.folder / "phm.jsonl").read_text().replace('"boot_id":"', f'"boot_id":"{number}')
        (made.folder / "phm.jsonl").write_text(lines)
        engine.containers[f"c{number}"] = container(f"c{number}", folders={PLACE: made.folder})
    for _ in range(2):
        assert collect(tmp_path / "out", engine=engine).exit_code == 0
        found = {path.name: len(texts(path)) for path in (tmp_path / "out").iterdir() if path.is_dir()}
        assert found == {"uav": 1, "uav-2": 2, "uav-2-2": 3}


def test_one_log_in_two_containers_is_there_once(tmp_path: Path, engine: FakeEngine, agent: Agent) -> None:
    """A container that ships logs shares the volume."""
    engine.containers["shipper"] = container("shipper", folders={PLACE: agent.folder})
    agent.rotate()
    for _ in range(2):
        assert collect(tmp_path / "out", engine=engine).exit_code == 0
        assert [path.name for path in (tmp_path / "out").iterdir() if path.is_dir()] == ["agent_1"]
        assert texts(tmp_path / "out" / "agent_1") == list(range(1, agent.count + 1))
        agent.write()


def test_options_choose_containers_and_their_folder(tmp_path: Path, engine: FakeEngine, agent: Agent) -> None:
    """By name, by --path, and by the label `phm.logs`."""
    other = Agent(tmp_path / "in" / "2", 2)
    other.write()
    engine.containers["second"] = container("second", folders={"/data/log": other.folder})
    result = collect(tmp_path / "a", "--container", "sec*", "--container", "none", engine=engine)
    assert result.exit_code == 1 and "has no phm.jsonl in /var/log/phm: name the folder with --path" in result.output
    assert "container none at" in result.output
    assert collect(tmp_path / "b", "--container", "second", "--path", "/data/log", engine=engine).exit_code == 0
    assert [path.name for path in (tmp_path / "b").iterdir() if path.is_dir()] == ["agent_2"]
    engine.containers["second"]["Config"]["Labels"]["phm.logs"] = "/data/log"
    assert collect(tmp_path / "c", engine=engine).exit_code == 0
    assert sorted(path.name for path in (tmp_path / "c").iterdir() if path.is_dir()) == ["agent_1", "agent_2"]
    other.log.close()


def test_a_mounted_card_is_collected(tmp_path: Path, agent: Agent) -> None:
    """Without an engine; logs are found in subfolders, links are not followed, and a second run fetches nothing."""
    agent.rotate()
    (tmp_path / "in" / "other").mkdir()
    (tmp_path / "in" / "other" / "phm.jsonl").symlink_to("/etc/passwd")
    for fetched in (True, False):
        result = collect(tmp_path / "out", tmp_path / "in", "--json")
        said = json.loads(result.output)
        assert (said["logs"][0]["fetched"] > 0) is fetched and len(said["logs"]) == 1, said
        assert texts(tmp_path / "out" / "agent_1") == list(range(1, agent.count + 1))
    missing = collect(tmp_path / "out", tmp_path / "nothing")
    assert missing.exit_code == 1 and "does not exist" in missing.output


def test_the_folder_itself_is_not_collected(tmp_path: Path, agent: Agent) -> None:
    """Not as a path, and not below one."""
    for _ in range(2):
        assert collect(tmp_path / "in" / "out", tmp_path / "in", "--json").exit_code == 0
    assert [path.name for path in (tmp_path / "in" / "out").iterdir() if path.is_dir()] == ["agent_1"]
    result = collect(tmp_path / "in", tmp_path / "in" / "1")
    assert result.exit_code == 2 and "into which the logs are collected" in result.output


def test_a_card_and_a_container_with_the_same_log_give_one_record(
    tmp_path: Path, engine: FakeEngine, agent: Agent
) -> None:
    """By radio first, from the card after landing."""
    assert collect(tmp_path / "out", engine=engine).exit_code == 0
    agent.rotate()
    assert collect(tmp_path / "out", agent.folder).exit_code == 0
    assert texts(tmp_path / "out" / "agent_1") == list(range(1, agent.count + 1))
    assert [path.name for path in (tmp_path / "out").iterdir() if path.is_dir()] == ["agent_1"]


def test_an_emptied_file_is_kept(tmp_path: Path, engine: FakeEngine, agent: Agent) -> None:
    """Another program has emptied the log: what was collected stays, in the right place."""
    agent.rotate()
    assert collect(tmp_path / "out", engine=engine).exit_code == 0
    os.truncate(agent.folder / "phm.jsonl", 0)
    agent.write(2)
    assert collect(tmp_path / "out", engine=engine).exit_code == 0
    assert texts(tmp_path / "out" / "agent_1") == list(range(1, agent.count + 1))


def test_an_interrupted_run_is_continued(
    tmp_path: Path, engine: FakeEngine, agent: Agent, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At any rename: nothing is lost, and the next run has the usual names."""
    out = tmp_path / "out"
    real, left = os.replace, [0]

    def replace(*words: Any) -> None:
        left[0] -= 1
        if left[0] == 0:
            raise KeyboardInterrupt
        real(*words)

    for place in range(1, 12):
        agent.rotate()
        left[0] = place
        with monkeypatch.context() as patched:
            patched.setattr("phm.logs.copies.os.replace", replace)
            collect(out, engine=engine)
        assert collect(out, engine=engine).exit_code == 0
        assert texts(out / "agent_1") == list(range(1, agent.count + 1)), place
    assert not [*out.rglob("*.moving*")] and not [*out.glob(".phm-collect-*")]


def test_more_files_than_have_a_number_are_put_aside(tmp_path: Path) -> None:
    """Into folders that a report and `phm logs` read, too, in order; what is there is known."""
    folder, given = tmp_path / "agent", 0
    for turn in range(12):
        staged: list[Path] = []
        for _ in range(30):
            given += 1
            path = tmp_path / f"{given}.gz"
            line = {"agent": "a", "boot_id": "b", "seq": given, "event": "note", "text": f"event {given}"}
            path.write_bytes(gzip.compress(json.dumps(line).encode() + b"\n"))
            staged.insert(0, path)
        kept = Copies(folder, "phm.jsonl")
        kept.take([Fetched(key_of(path), path, False) for path in staged])
        assert len(kept.keys()) == given, turn
    assert sorted(path.name for path in folder.iterdir() if path.is_dir()) == ["older-1", "older-2", "older-3"]
    found = [number for part in ("older-1", "older-2", "older-3", ".") for number in texts(folder / part)]
    assert found == list(range(1, given + 1))
    shown = CliRunner().invoke(group, ["logs", str(tmp_path), "--json"])
    assert shown.output.count('"note"') == given


def test_two_runs_do_not_write_into_one_folder(tmp_path: Path, engine: FakeEngine, agent: Agent) -> None:
    """The second one says so."""
    with Collection(tmp_path / "out").open():
        result = collect(tmp_path / "out", engine=engine)
    assert result.exit_code == 1 and "another `phm logs collect` writes into" in result.output


def test_a_damaged_index_costs_only_time(tmp_path: Path, engine: FakeEngine, agent: Agent) -> None:
    """Everything is fetched again, and nothing is there twice."""
    agent.rotate()
    out = tmp_path / "out"
    assert collect(out, engine=engine).exit_code == 0
    for text in (
        "{",
        "[]",
        '{"sources": 5, "marks": {"agent_1/phm.jsonl": 3}, "agents": {"agent_1": 7}}',
        '{"agents": []}',
    ):
        (out / ".phm-collect.json").write_text(text)
        assert collect(out, engine=engine).exit_code == 0, text
        names = [path.name for path in out.iterdir() if path.is_dir()]
        assert names == ["agent_1"], text
