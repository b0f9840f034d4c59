"""Agents with logs that the log reporter writes, in containers of the fake engine, and `phm logs collect`."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from phm.cli import group
from phm.core.settings import Settings
from phm.reporters.log import LogReporter
from phm.wire import json_log
from tests.fakes.engine import FakeEngine, container
from tests.fakes.records import context
from tests.fakes.until import until
from tests.logs.test_logs import note

PLACE = "/var/log/phm"
SMALL: dict[str, Any] = {"max_size": 10_000, "files": 2}


class Agent:
    """A container's folder with a log that is written."""

    def __init__(self, folder: Path, number: int = 1, name: str = "", **log: Any) -> None:
        self.folder, self.count = folder, 0
        agent = {"name": name or f"agent_{number}", "id": number}
        settings = {"agent": agent, "log": {"directory": str(folder), **log}, "state_dir": str(folder / "state")}
        self.log = LogReporter.build(context(Settings.model_validate(settings)))
        self.log.tick()  # writes the first line

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
