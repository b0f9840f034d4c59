"""`phm learn` on a real application: what it writes is valid, passes, and catches faults."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml
from docker import DockerClient

from sitl.harness.log_follower import Event
from tests.system.conftest import ROOT, AppContainer, Phm, poll

INSIDE = "/ws/data"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "data"
    (made / "below").mkdir(parents=True)
    for number in range(200):
        (made / "below" / f"file_{number}").write_text(str(number))
    return made


@pytest.fixture
def app(docker_client: DockerClient, folder: Path) -> Iterator[AppContainer]:
    """The demo's application with a folder of the host."""
    started = AppContainer(docker_client, volumes={str(folder): {"bind": INSIDE, "mode": "rw"}})
    try:
        yield started
    finally:
        started.remove()


def cli(app: AppContainer, *words: str) -> str:
    argv = [sys.executable, "-m", "phm.cli", *words]
    environ = {**os.environ, "ROS_DOMAIN_ID": str(app.domain)}
    done = subprocess.run(argv, cwd=ROOT, env=environ, capture_output=True, text=True, timeout=240, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def healthy(app: AppContainer) -> bool:
    app.container.reload()
    return bool(app.container.attrs["State"].get("Health", {}).get("Status") == "healthy")


def opened(unit: str) -> Callable[[Event], bool]:
    return lambda event: bool(event["event"] == "fault_opened" and event["unit"] == unit)


def clean(event: Event) -> bool:
    return bool(event["event"] == "report" and set(event["slots"].values()) == {"OK"})


@pytest.mark.long
def test_a_learned_baseline_passes_and_catches_faults(
    app: AppContainer, folder: Path, start_phm: Callable[..., Phm], tmp_path: Path
) -> None:
    """Three nodes in a ring, and 200 files. Then a file is altered and a node killed."""
    poll(lambda: healthy(app), "a healthy application")
    output = tmp_path / "phm.yaml"
    words = ("--fresh", "--container", app.name, "--files", f"{app.name}:{INSIDE}", "--output", str(output))
    cli(app, "learn", "--for", "12s", *words)
    cli(app, "validate", str(output))
    learned = yaml.safe_load(output.read_text())
    nodes = [f"/agent_1/node_{number}" for number in (1, 2, 3)]
    assert [node["name"] for node in learned["ros"]["nodes"]] == nodes
    ends = [(topic["publishers"], topic["subscribers"], topic["type"]) for topic in learned["ros"]["topics"]]
    assert ends == [([nodes[n]], [nodes[(n + 1) % 3]], "std_msgs/msg/String") for n in range(3)]
    (container,) = learned["containers"]
    assert (container["healthcheck"], container["networks"]) == ("required", [app.name])

    for file in container["files"]:
        file["manifest"] = str(tmp_path / file["manifest"])
    # The load of the machine that runs the tests is not what this is about.
    learned["checks"] = {"host": {"enabled": False}, "pressure": {"enabled": False}}
    phm = start_phm({"interval": "3s", **learned}, app.domain)
    phm.wait(clean, "a clean report")
    phm.wait(clean, "a second one", since=phm.mark())
    (folder / "below" / "file_7").write_text("altered")
    fault = phm.wait(opened(f"files/{app.name}"), "a fault at the altered file")
    assert fault["condition"] == "tree_altered" and "changed: below/file_7" in fault["summary"]
    app.kill_node("node_2")
    phm.wait(opened("nodes/agent_1/node_2"), "a fault at the killed node")
    assert phm.opened(0) == [f"files/{app.name}", "nodes/agent_1/node_2"]
