"""`phm logs collect` with a Docker Engine on a real socket, and logs that the log reporter writes and rotates meanwhile."""

from __future__ import annotations

import gzip
import io
import json
import os
import sys
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from phm.cli import group
from phm.core.settings import Settings
from phm.logs import log_sources
from phm.logs.collect import Collection
from phm.logs.copies import Copies, Fetched, key_of
from phm.reporters.log import LogReporter
from phm.wire import json_log
from tests.cli.test_logs import note
from tests.fakes.engine import FakeEngine, container
from tests.fakes.engine_faults import Hang, Status, Trickle, Truncate
from tests.fakes.records import context
from tests.fakes.until import until

PLACE = "/var/log/phm"
SMALL: dict[str, Any] = {"max_size": 10_000, "files": 2}


class Agent:
    """A container's folder with a log that is written."""

    def __init__(self, folder: Path, number: int = 1, name: str = "", **log: Any) -> None:
        self.folder, self.count = folder, 0
        agent = {"name": name or f"agent_{number}", "id": number}
        settings = {"agent": agent, "log": {"directory": str(folder), **log}, "state_dir": str(folder / "state")}
        self.log = LogReporter.build(context(Settings.model_validate(settings)))

    def write(self, lines: int = 1) -> None:
        for _ in range(lines):
            self.count += 1
            self.log.handle(note(f"event {self.count} {'x' * 100}", float(self.count)))

    def rotate(self) -> None:
        """Write until there is a new file, and until the rotated ones are compressed."""
        before = self._inode()
        until(lambda: self._inode() != before, "a rotation", step=self.write)
        until(self.compressed, "the compression")

    def compressed(self) -> bool:
        return not [path for path in self.folder.glob("phm.jsonl.*") if not path.name.endswith(".gz")]

    def _inode(self) -> int:
        return os.stat(self.folder / "phm.jsonl").st_ino


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[FakeEngine]:
    with FakeEngine(tmp_path / "engine.sock") as fake:
        yield fake
        assert not fake.errors


@pytest.fixture
def agent(tmp_path: Path, engine: FakeEngine) -> Iterator[Agent]:
    made = Agent(tmp_path / "in" / "1", **SMALL)
    made.write(3)
    engine.containers["phm"] = container("phm", folders={PLACE: made.folder})
    engine.containers["ros_app"] = container("ros_app")
    yield made
    made.log.close()


def collect(*words: str | Path, engine: FakeEngine | None = None) -> Result:
    """Progress and problems are in the same output."""
    given = [*map(str, words), *(["--docker", engine.url] if engine else [])]
    return CliRunner().invoke(group, ["logs", "collect", *given])


def texts(folder: Path) -> list[int]:
    """The numbers of the events in a folder of logs, in order."""
    return [int(line["text"].split()[1]) for line in json_log.read(folder) if line["event"] == "note"]


def copies(fake: FakeEngine) -> int:
    return len([call for call in fake.calls if call.startswith("GET") and call.endswith("/archive")])


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


def test_what_the_agent_removed_meanwhile_is_kept(tmp_path: Path, engine: FakeEngine, agent: Agent) -> None:
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


def _tar(*members: tarfile.TarInfo, content: bytes = b"x" * 10) -> bytes:
    made = io.BytesIO()
    with tarfile.open(fileobj=made, mode="w") as archive:
        for member in members:
            archive.addfile(member, io.BytesIO(content) if member.isreg() else None)
    return made.getvalue()


def _member(name: str, kind: bytes = tarfile.REGTYPE, link: str = "", size: int = 0) -> tarfile.TarInfo:
    made = tarfile.TarInfo(name)
    made.type, made.linkname, made.size = kind, link, size
    return made


HOSTILE = {
    "link": _tar(_member("phm.jsonl.1.gz", tarfile.SYMTYPE, "/etc/passwd")),
    "hard link": _tar(_member("phm.jsonl.1.gz", tarfile.LNKTYPE, "/etc/passwd")),
    "device": _tar(_member("phm.jsonl.1.gz", tarfile.CHRTYPE)),
    "folder": _tar(_member("phm.jsonl.1.gz", tarfile.DIRTYPE)),
    "too large": _member("phm.jsonl.1.gz", size=1 << 45).tobuf(),
    "torn": _tar(_member("phm.jsonl.1.gz", size=10))[:515],
    "no tar": b"\x00\xff" * 700,
    "empty": b"",
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_hostile_tar_gives_no_file_and_costs_only_that_file(
    tmp_path: Path, engine: FakeEngine, agent: Agent, kind: str
) -> None:
    """It is listed as missing; the other files are there."""
    agent.rotate()
    engine.containers["phm"]["_tars"][f"{PLACE}/phm.jsonl.1.gz"] = HOSTILE[kind] or b"\0"
    out = tmp_path / "out"
    result = collect(out, engine=engine)
    assert result.exit_code == 1 and "missing: " in result.output and "phm.jsonl.1.gz" in result.output, result.output
    made = sorted(path.name for path in out.rglob("*") if not path.name.startswith("."))
    assert made == ["agent_1", "phm.jsonl", "phm.log"]
    del engine.containers["phm"]["_tars"][f"{PLACE}/phm.jsonl.1.gz"]
    assert collect(out, engine=engine).exit_code == 0
    assert texts(out / "agent_1") == list(range(1, agent.count + 1))


@pytest.mark.parametrize("name", ["../../outside", "/absolute", "a/../../b"])
def test_names_in_a_tar_are_not_used(tmp_path: Path, engine: FakeEngine, agent: Agent, name: str) -> None:
    """The content has the name that was asked for; nothing is written elsewhere."""
    content = (agent.folder / "phm.jsonl").read_bytes()
    engine.containers["phm"]["_tars"][f"{PLACE}/phm.jsonl"] = _tar(_member(name, size=len(content)), content=content)
    out = tmp_path / "deep" / "er" / "out"
    assert collect(out, engine=engine).exit_code == 0
    assert texts(out / "agent_1") == [1, 2, 3]
    assert {path.name for path in out.parent.iterdir()} == {"out"} and [*tmp_path.glob("outside")] == []


def test_the_name_of_an_agent_is_not_a_path(tmp_path: Path, engine: FakeEngine) -> None:
    """It comes from the log, which may be hostile."""
    for number, name in enumerate(("../../up", "/etc", "..", ".", "a\nb\x1b[2J", "")):
        folder = tmp_path / "in" / str(number)
        folder.mkdir(parents=True)
        line = {
            "v": 2,
            "agent": name,
            "agent_id": number,
            "boot_id": f"b{number}",
            "seq": 1,
            "event": "note",
            "text": "x 1",
        }
        (folder / "phm.jsonl").write_text(json.dumps(line) + "\n")
        engine.containers[f"c{number}"] = container(f"c{number}", folders={PLACE: folder})
    out = tmp_path / "a" / "b" / "out"
    result = collect(out, engine=engine)
    assert result.exit_code == 0 and "\x1b" not in result.output, result.output
    assert [path.name for path in (tmp_path / "a" / "b").iterdir()] == ["out"]
    assert len([path for path in out.iterdir() if (path / "phm.jsonl").is_file()]) == 6


def test_links_in_the_container_are_not_followed(tmp_path: Path, engine: FakeEngine, agent: Agent) -> None:
    """A rotated file that is a link to something else is not a log."""
    (agent.folder / "phm.jsonl.1").symlink_to("/etc/passwd")
    out = tmp_path / "out"
    assert collect(out, engine=engine).exit_code == 0
    assert not list(out.rglob("phm.jsonl.1*"))


@pytest.mark.parametrize(
    "fault",
    [Hang("phm.jsonl GET"), Trickle("phm.jsonl GET"), Truncate("phm.jsonl GET"), Status(500, "x", "phm.jsonl GET")],
)
def test_a_copy_that_fails_costs_only_that_file(
    tmp_path: Path, engine: FakeEngine, agent: Agent, monkeypatch: pytest.MonkeyPatch, fault: Any
) -> None:
    """It ends at its deadline; the next run completes it."""
    monkeypatch.setattr(log_sources, "LOOK_S", 1.0)
    agent.rotate()
    engine.fault = fault
    out = tmp_path / "out"
    result = collect(out, engine=engine)
    assert result.exit_code == 1 and "phm.jsonl: " in result.output, result.output
    assert texts(out / "agent_1") == texts(agent.folder)[: len(texts(out / "agent_1"))] != []
    engine.fault = None
    assert collect(out, engine=engine).exit_code == 0
    assert texts(out / "agent_1") == list(range(1, agent.count + 1))


def test_the_beginning_of_a_torn_copy_is_kept(tmp_path: Path, engine: FakeEngine) -> None:
    """The vehicle may not come back: what came of a file that is written is there, and the rest is said to be missing."""
    agent = Agent(tmp_path / "in" / "1")
    agent.write(1000)
    agent.log.close()
    engine.containers["phm"] = container("phm", folders={PLACE: agent.folder})
    content = (agent.folder / "phm.jsonl").read_bytes()
    whole = _tar(_member("phm.jsonl", size=len(content)), content=content)
    engine.containers["phm"]["_tars"][f"{PLACE}/phm.jsonl"] = whole[: 512 + len(content) // 2]
    out = tmp_path / "out"
    result = collect(out, engine=engine)
    assert result.exit_code == 1 and f"of {len(content)} bytes" in result.output
    kept = texts(out / "agent_1")
    assert 0 < len(kept) < agent.count and kept == list(range(1, len(kept) + 1))


def test_an_engine_that_is_not_there_costs_only_its_agents(tmp_path: Path, engine: FakeEngine, agent: Agent) -> None:
    """Each engine is asked, and what is missing is said."""
    result = collect(tmp_path / "out", "--docker", f"unix://{tmp_path}/none.sock", engine=engine)
    assert result.exit_code == 1 and f"missing: unix://{tmp_path}/none.sock: " in result.output
    assert texts(tmp_path / "out" / "agent_1") == [1, 2, 3]


def test_an_engine_that_hangs_ends_at_its_deadline(
    tmp_path: Path, engine: FakeEngine, agent: Agent, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The list of containers, too, has one."""
    monkeypatch.setattr(log_sources, "LOOK_S", 0.5)
    engine.fault = Hang("/containers/json")
    result = collect(tmp_path / "out", engine=engine)
    assert result.exit_code == 1 and "did not answer within" in result.output


def test_an_engine_is_reached_through_ssh(
    tmp_path: Path, engine: FakeEngine, agent: Agent, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the system's `ssh`, here a program that connects its streams with the engine; nothing it is given can be an option."""
    agent.rotate()
    programs = tmp_path / "bin"
    programs.mkdir()
    relay = f"""#!{sys.executable} -SI
import os, select, socket, sys
open({str(tmp_path / "words")!r}, "a").write(" ".join(sys.argv[1:]) + chr(10))
sock = socket.socket(socket.AF_UNIX)
sock.connect({engine.path!r})
ends = {{0: sock.fileno(), sock.fileno(): 1}}
while True:
    for end in select.select(list(ends), [], [])[0]:
        data = os.read(end, 65536)
        if not data:
            sys.exit()
        os.write(ends[end], data)
"""
    (programs / "ssh").write_text(relay)
    (programs / "ssh").chmod(0o755)
    monkeypatch.setenv("PATH", f"{programs}:{os.environ['PATH']}")
    result = collect(tmp_path / "out", "--docker", "ssh://pi@drone5:2222")
    assert result.exit_code == 0, result.output
    assert texts(tmp_path / "out" / "agent_1") == list(range(1, agent.count + 1))
    words = (tmp_path / "words").read_text().splitlines()[0]
    assert words.endswith("-l pi -p 2222 -- drone5 docker system dial-stdio")


def test_ssh_that_hangs_ends_at_the_deadline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The program is left to end, since its connection is closed."""
    (tmp_path / "ssh").write_text("#!/bin/sh\ncat >/dev/null\n")
    (tmp_path / "ssh").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    monkeypatch.setattr(log_sources, "LOOK_S", 0.5)
    result = collect(tmp_path / "out", "--docker", "ssh://drone5")
    assert result.exit_code == 1 and "did not answer within" in result.output


@pytest.mark.parametrize(
    "url",
    [
        "ssh://-oProxyCommand=x",
        "ssh://-l@host",
        "http://host",
        "unix://host/x",
        "tcp://",
        "tcp://h:99999",
        "ssh://a/b",
        "host",
    ],
)
def test_a_wrong_address_is_refused(tmp_path: Path, url: str) -> None:
    """Also one that `ssh` would take for an option."""
    result = collect(tmp_path / "out", "--docker", url)
    assert result.exit_code == 2 and "is not the address of a Docker Engine" in result.output
    assert not (tmp_path / "out").exists()


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


def test_no_log_can_replace_what_was_collected(tmp_path: Path, engine: FakeEngine, agent: Agent) -> None:
    """A copy is replaced only by one that begins with all that it has: a first line can be forged."""
    out = tmp_path / "out"
    assert collect(out, engine=engine).exit_code == 0
    before = (out / "agent_1" / "phm.jsonl").read_bytes()
    first = before.splitlines(keepends=True)[0]
    (agent.folder / "phm.jsonl").write_bytes(first + b'{"forged": true}\n' * 1000)
    assert collect(out, engine=engine).exit_code == 0
    for _ in range(3):
        files = [path.read_bytes() for path in (out / "agent_1").glob("phm.jsonl*")]
        assert before in files and len(files) == 2
        with (agent.folder / "phm.jsonl").open("ab") as log:
            log.write(b'{"forged": true}\n')
        assert collect(out, engine=engine).exit_code == 0


def test_a_compressed_file_without_end_costs_little(tmp_path: Path, engine: FakeEngine) -> None:
    """It names no agent: PHM does not look for one in all of it."""
    folder = tmp_path / "in"
    folder.mkdir()
    with gzip.open(folder / "phm.jsonl.1.gz", "wb", 1) as log:
        for _ in range(100):
            log.write(b"{}\n" * 500_000)
    (folder / "phm.log").write_text("text\n")
    engine.containers["bomb"] = container("bomb", folders={PLACE: folder})
    result = collect(tmp_path / "out", engine=engine)
    assert result.exit_code == 0 and (tmp_path / "out" / "bomb" / "phm.jsonl.1.gz").is_file(), result.output


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
