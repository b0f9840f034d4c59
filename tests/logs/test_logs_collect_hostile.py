"""`phm logs collect` from containers, engines and logs that are hostile, or fail."""

from __future__ import annotations

import gzip
import io
import json
import os
import shutil
import sys
import tarfile
from pathlib import Path
from typing import Any

import pytest

from phm.cli import logs_collect
from phm.logs import log_sources
from phm.transport.docker import DockerEngine
from tests.fakes.engine import FakeEngine, container
from tests.fakes.engine_faults import Hang, Status, Trickle, Truncate
from tests.fakes.log_agents import PLACE, Agent, agent as agent, collect, engine as engine, texts
from tests.fakes.until import until
from tests.logs.conftest import ANSWER_S


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
    monkeypatch.setattr(log_sources, "ANSWER_S", 1.0)
    agent.rotate()
    engine.fault = fault
    out = tmp_path / "out"

    def without_it() -> bool:
        """Where the machine is so busy that another file exceeds its deadline, too, the next run completes that one."""
        result = collect(out, engine=engine)
        assert result.exit_code == 1, result.output
        return "phm.jsonl: " in result.output and bool(texts(out / "agent_1"))

    until(without_it, "the other files")
    assert texts(out / "agent_1") == texts(agent.folder)[: len(texts(out / "agent_1"))]
    engine.fault = None
    monkeypatch.setattr(log_sources, "ANSWER_S", ANSWER_S)
    assert collect(out, engine=engine).exit_code == 0
    assert texts(out / "agent_1") == list(range(1, agent.count + 1))


def test_files_behind_many_that_cannot_be_read_are_fetched(
    tmp_path: Path, agent: Agent, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of those is listed."""
    for _ in range(2):
        agent.rotate()
    old = agent.folder / "phm.jsonl.2.gz"
    expected = sorted(path.name for path in agent.folder.glob("phm.jsonl*"))
    shutil.copy(old, agent.folder / "phm.jsonl.3.gz")
    real = os.open

    def opened(path: Any, *given: Any, **more: Any) -> int:
        if Path(path).parent == agent.folder and Path(path).name in expected:
            raise PermissionError(13, "Permission denied", path)
        return real(path, *given, **more)

    monkeypatch.setattr("os.open", opened)
    result = collect(tmp_path / "out", tmp_path / "in")
    assert result.exit_code == 1 and len(expected) == 3, result.output
    assert all(f"{name}: Permission denied" in result.output for name in expected), result.output
    assert len(texts(tmp_path / "out" / "agent_1")) > 0


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


def test_a_ground_computer_without_an_engine_names_the_agents(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another engine than that of this computer is what the operator meant."""
    advice = "; or name the agents: --docker ssh://USER@HOST, or a folder"
    monkeypatch.delenv("DOCKER_HOST", raising=False)
    monkeypatch.setattr(logs_collect, "ENGINE", f"unix://{tmp_path}/none.sock")
    result = collect(tmp_path / "out")
    assert result.exit_code == 1 and result.output.rstrip().endswith(advice), result.output
    assert advice not in collect(tmp_path / "out", "--docker", f"unix://{tmp_path}/other.sock").output


def test_containers_beyond_the_limit_are_named(
    tmp_path: Path, engine: FakeEngine, agent: Agent, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With exit code 1; a pattern that chooses fewer containers is within the limit."""
    monkeypatch.setattr(log_sources, "MOST_CONTAINERS", 1)
    result = collect(tmp_path / "out", engine=engine)
    assert result.exit_code == 1 and "1 of 2 were not searched" in result.output, result.output
    assert collect(tmp_path / "out", "--container", "phm", engine=engine).exit_code == 0, (
        "the limit is of those that are looked at"
    )


def test_an_engine_that_hangs_ends_at_its_deadline(
    tmp_path: Path, engine: FakeEngine, agent: Agent, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The list of containers, too, has one."""
    monkeypatch.setattr(log_sources, "ANSWER_S", 0.5)
    engine.fault = Hang("/containers/json")
    result = collect(tmp_path / "out", engine=engine)
    assert result.exit_code == 1 and "did not answer within" in result.output


def test_an_engine_that_hangs_after_its_list_is_given_up(
    tmp_path: Path, engine: FakeEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is not asked about each of many containers."""
    listed = DockerEngine.list
    # It has answered, however busy the machine is; the deadline is that of the questions about containers.
    monkeypatch.setattr(DockerEngine, "list", lambda self, **_: listed(self, deadline_s=ANSWER_S))
    monkeypatch.setattr(log_sources, "ANSWER_S", 0.3)
    for number in range(20):
        engine.containers[f"c{number}"] = container(f"c{number}")
    engine.fault = Hang("/archive")
    result = collect(tmp_path / "out", engine=engine)
    assert result.exit_code == 1 and "the other containers at" in result.output
    assert result.output.count("missing: container c") == 3
    assert len([call for call in engine.calls if call.endswith("/archive")]) <= 3


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
    monkeypatch.setattr(log_sources, "ANSWER_S", 0.5)
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


def test_no_link_of_a_folder_from_someone_else_is_followed(tmp_path: Path, engine: FakeEngine, agent: Agent) -> None:
    """Not under the name of the index's new file, and not as the folder of an agent."""
    out, mine, other = tmp_path / "out", tmp_path / "mine", tmp_path / "other"
    assert collect(out, engine=engine).exit_code == 0
    mine.write_text("precious")
    (out / ".phm-collect.tmp").symlink_to(mine)
    (out / "agent_1").rename(other)
    (out / "agent_1").symlink_to(other)
    before = sorted(path.name for path in other.iterdir())
    agent.write()
    assert collect(out, engine=engine).exit_code == 0
    assert mine.read_text() == "precious" and sorted(path.name for path in other.iterdir()) == before
    (made,) = [path for path in out.iterdir() if path.is_dir() and not path.is_symlink()]
    assert texts(made) == list(range(1, agent.count + 1))


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


def test_a_long_name_of_an_agent_costs_no_other_log(tmp_path: Path, engine: FakeEngine, agent: Agent) -> None:
    """In characters of several bytes it is longer than a file system allows."""
    folder = tmp_path / "in" / "long"
    folder.mkdir(parents=True)
    line = {"v": 2, "agent": "\u6a5f" * 100, "agent_id": 9, "boot_id": "b", "seq": 1, "event": "note", "text": "x 1"}
    (folder / "phm.jsonl").write_text(json.dumps(line) + "\n")
    engine.containers["long"] = container("long", folders={PLACE: folder})
    for _ in range(2):
        result = collect(tmp_path / "out", engine=engine)
        assert result.exit_code == 0, result.output
        assert sorted(len(texts(path)) for path in (tmp_path / "out").iterdir() if path.is_dir()) == [1, 3]


def test_an_index_that_names_no_agent_costs_only_time(tmp_path: Path, engine: FakeEngine) -> None:
    """It may come from someone else: a folder without an agent, of a source that has only a log of text."""
    folder = tmp_path / "in"
    folder.mkdir()
    (folder / "phm.log").write_text("text\n")
    engine.containers["c"] = container("c", folders={PLACE: folder})
    out = tmp_path / "out"
    out.mkdir()
    index = {"sources": {f"container c at {engine.url}": "uav"}, "agents": {"uav": ["", 1]}, "marks": {}}
    (out / ".phm-collect.json").write_text(json.dumps(index))
    result = collect(out, engine=engine)
    assert result.exit_code == 1 and "phm.jsonl: there is none" in result.output, result.output
    assert (out / "c" / "phm.log").read_text() == "text\n"


def test_a_folder_that_cannot_be_read_is_said(tmp_path: Path, agent: Agent, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is beside it is collected; the folder of a file system's own, which only root can read, is not meant."""
    (tmp_path / "in" / "2").mkdir()
    (tmp_path / "in" / "lost+found").mkdir()
    real = os.scandir

    def scandir(path: str | int) -> Any:
        if isinstance(path, str) and os.path.basename(path) in ("2", "lost+found"):
            raise PermissionError(13, "Permission denied", path)
        return real(path)

    monkeypatch.setattr("os.scandir", scandir)
    result = collect(tmp_path / "out", tmp_path / "in")
    assert result.exit_code == 1 and f"missing: {tmp_path}/in/2: Permission denied" in result.output, result.output
    assert "lost+found" not in result.output and texts(tmp_path / "out" / "agent_1") == [1, 2, 3]
