"""`phm logs bundle` ends in its time whatever hangs; what was not collected is listed with the reason."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Collection, Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from phm.cli import group
from phm.doctor import examination
from phm.doctor.row import Row
from phm.logs.deadline import Deadline, Late
from tests.fakes.until import until
from tests.logs.test_logs import note, record
from tests.logs.test_logs_bundle import members

CONFIG = """\
agent: {{name: agent_1, id: 1}}
log: {{directory: {folder}/log}}
state_dir: {folder}/state
docker: {{socket: "unix://{folder}/engine.sock"}}
containers:
  - {{name: app}}
  - {{name: other}}
"""
GOOD = {"phm.yaml", "environment.json", "REMOVED.txt", "MISSING.txt", "logs/phm.jsonl", "logs/phm.log"}


@pytest.fixture
def engine(tmp_path: Path) -> Iterator[socket.socket]:
    """Takes connections and never answers, as an engine that hangs."""
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "engine.sock"))
        server.listen(64)
        yield server


@pytest.fixture
def config(tmp_path: Path) -> Path:
    file = tmp_path / "phm.yaml"
    file.write_text(CONFIG.format(folder=tmp_path))
    record(tmp_path / "log", note("an ordinary line"))
    return file


def bundle(config: Path, timeout: str) -> Result:
    words = ["logs", "bundle", str(config.parent / "x.tar.gz"), "-c", str(config), "--timeout", timeout]
    return CliRunner().invoke(group, [*words, "--run-dir", str(config.parent / "run")])


def bundle_with(config: Path, wanted: Collection[str]) -> tuple[Result, dict[str, bytes]]:
    """What `phm logs bundle` says and what is in its file, with the parts that do not hang. Where the machine itself stops the program
    for their share of the time they are rightly left out, and it is done again.
    """
    file = config.parent / "x.tar.gz"

    def made() -> tuple[Result, dict[str, bytes]] | None:
        file.unlink(missing_ok=True)
        result = bundle(config, "8s")
        assert result.exit_code == 0, result.output
        inside = members(file)
        return (result, inside) if set(inside) >= set(wanted) else None

    found: tuple[Result, dict[str, bytes]] = until(made, f"{sorted(wanted)}", lambda: members(file)["MISSING.txt"])
    return found


def test_an_engine_that_hangs_costs_its_own_parts_alone(config: Path, engine: socket.socket) -> None:
    """Each of its containers is named; configuration, logs and the rest are there."""
    result, inside = bundle_with(config, GOOD)
    assert b"an ordinary line" in inside["logs/phm.jsonl"]
    missing = inside["MISSING.txt"].decode()
    assert "container app: " in missing and "container other: " in missing
    assert "not in it: container app: " in result.output


def test_a_part_of_doctor_that_hangs_is_said_and_the_others_are_there(
    config: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bundle does not wait for it."""
    end = threading.Event()

    def hangs(_: object) -> list[Row]:
        end.wait()
        return []

    monkeypatch.setitem(examination.GROUPS, "kernel", hangs)
    try:
        _, inside = bundle_with(config, {"doctor.txt"})
    finally:
        end.set()
    doctor = inside["doctor.txt"].decode()
    assert "kernel: answer: limited: not known within" in doctor and "storage: " in doctor


def test_a_file_that_cannot_be_read_in_time_is_named(config: Path) -> None:
    """A pipe of that name has no end; of a signing key it is said that it cannot be removed elsewhere."""
    folder = config.parent
    (folder / "run").mkdir()
    os.mkfifo(folder / "run" / "status.json")
    os.mkfifo(folder / "key")
    config.write_text(f"{config.read_text()}mavlink: {{signing: {{key: {folder}/key}}}}\n")
    _, inside = bundle_with(config, GOOD)
    missing = inside["MISSING.txt"].decode()
    assert "status.json: " in missing and "MAVLink signing key: " in missing and "not removed" in missing


def test_a_configuration_that_cannot_be_read_in_time_is_named(config: Path) -> None:
    """The bundle is written without it."""
    config.unlink()
    os.mkfifo(config)
    result = bundle(config, "6s")
    assert result.exit_code == 0, result.output
    inside = members(config.parent / "x.tar.gz")
    assert "phm.yaml" not in inside and "phm.yaml: " in inside["MISSING.txt"].decode()


def test_a_time_that_is_not_one_is_refused(config: Path) -> None:
    """With what is allowed."""
    result = bundle(config, "soon")
    assert result.exit_code == 2 and "90s, 10min or 1.5h" in result.output


def test_work_has_its_share_of_the_time() -> None:
    """Its result and its error come back; without time left it is not begun."""
    deadline, end = Deadline(3600.0), threading.Event()
    assert deadline.within(1.0, lambda: 7) == 7
    with pytest.raises(ZeroDivisionError):
        deadline.within(1.0, lambda: 1 // 0)
    with pytest.raises(Late, match="not done within"):
        Deadline(1.0).within(1.0, end.wait)
    end.set()
    begun: list[int] = []
    with pytest.raises(Late, match="not started within the time limit"):
        deadline.within(0.0, lambda: begun.append(1))
    assert not begun and 0.0 < deadline.left(0.5) <= 1800.0
