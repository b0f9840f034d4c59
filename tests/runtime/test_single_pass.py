"""`phm once`: what one pass reports."""

from __future__ import annotations

import json
from functools import partial
from itertools import count
from pathlib import Path

import pytest

from phm.core.model import Level
from phm.probes import cpu_usage, kernel_file
from phm.probes.host import Host
from phm.runtime.configuration import read
from phm.runtime.single_pass import run_once
from tests.fakes.engine import FakeEngine, container


@pytest.fixture
def proc(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A /proc with pressure files. In each reading of `stat` the CPU was busy for half of the time since the one before."""
    made = tmp_path / "proc"
    (made / "pressure").mkdir(parents=True)
    for name in ("cpu", "memory", "io"):
        (made / "pressure" / name).write_text("some avg10=0.00 total=0\nfull avg10=0.00 total=0\n", "ascii")
    (made / "meminfo").write_text("MemTotal: 1000 kB\nMemAvailable: 700 kB\n", "ascii")
    ticks = count(100, 50)

    def head(path: str, *size: int) -> str:
        if path != f"{made}/stat":
            return kernel_file.head(path, *size)
        spent = next(ticks)
        return f"cpu  {spent} 0 0 {spent} 0 0 0 0 0 0\n"

    monkeypatch.setattr(cpu_usage, "head", head)
    monkeypatch.setattr("phm.runtime.probe_set.Host", partial(Host, proc=made))
    return made


def test_the_host_is_measured_before_it_is_read(proc: Path, tmp_path: Path) -> None:
    """A pass takes long enough for shares of CPU and disks: nothing is invented, and nothing is said to be missing."""
    file = tmp_path / "phm.yaml"
    places = {"state_dir": str(tmp_path / "state"), "run_dir": str(tmp_path / "run")}
    engine = {"socket": f"unix://{tmp_path}/none.sock"}
    file.write_text(json.dumps({"agent": {"id": 1}, "docker": engine, **places}))
    units = {state.unit: state for state in run_once(read(str(file), {}, links=False))}
    cpu, io = units["host/cpu"], units["host/io"]
    assert (cpu.level, cpu.result.values["cpu_percent"]) == (Level.OK, 50.0), cpu.result.summary
    assert (io.level, io.result.bypass) == (Level.OK, False), io.result.summary
    assert not any(word in f"{cpu.result.summary} {io.result.summary}" for word in ("at 0 %", "does not count"))


def test_a_result_that_must_last_longer_than_the_pass_is_reported_as_found(tmp_path: Path) -> None:
    """A container that was created and not started: the daemon reports it after a minute, and one pass does not wait for that."""
    file = tmp_path / "phm.yaml"
    places = {"state_dir": str(tmp_path / "state"), "run_dir": str(tmp_path / "run")}
    with FakeEngine(f"{tmp_path}/engine.sock") as fake:
        fake.containers["app"] = container("app", status="created")
        app = {"name": "app", "healthcheck": "ignore", "pressure": "ignore"}
        document = {"agent": {"id": 1}, "docker": {"socket": fake.url}, "containers": [app], **places}
        file.write_text(json.dumps(document))
        units = {state.unit: state for state in run_once(read(str(file), {}, links=False))}
    found = units["container/app"]
    assert (found.level, found.result.condition) == (Level.ERROR, "not_started"), found.result.summary
