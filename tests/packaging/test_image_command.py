"""`phm` in the image is docker/phm, which gives the program the environment of the image's ROS distribution."""

from __future__ import annotations

import os
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = "/opt/phm/code/bin/phm"
ENTRYPOINT = '#!/bin/sh\nexport AMENT_PREFIX_PATH=/opt/ros/jazzy\necho sourced\nexec "$@"\n'
FAKE = '#!/bin/sh\necho "$$ $0 $AMENT_PREFIX_PATH"\nprintf "<%s>" "$@"\nexit 3\n'


def program(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    path.chmod(0o755)
    return path


@pytest.mark.parametrize(
    ("given", "sourced"), [({}, True), ({"AMENT_PREFIX_PATH": ""}, True), ({"AMENT_PREFIX_PATH": "/opt/x"}, False)]
)
def test_the_program_has_ros_without_an_entry_point(given: dict[str, str], sourced: bool, tmp_path: Path) -> None:
    """As with `docker exec`. ROS is sourced once, and the program has the process, the words and the exit code."""
    real = program(tmp_path / "real", FAKE)
    program(tmp_path / "ros-entrypoint", ENTRYPOINT)
    program(tmp_path / "phm", (ROOT / "docker" / "phm").read_text("utf-8").replace(PROGRAM, str(real)))
    kept = {name: value for name, value in os.environ.items() if name != "AMENT_PREFIX_PATH"}
    environment = {**kept, "PATH": f"{tmp_path}:{os.environ['PATH']}", **given}
    words = ["phm", "learn", "--for", "10 s", ""]
    with subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, text=True) as process:
        lines = process.communicate(timeout=60)[0].splitlines()
    ros = "/opt/ros/jazzy" if sourced else "/opt/x"
    assert lines == [*["sourced"] * sourced, f"{process.pid} {real} {ros}", "<learn><--for><10 s><>"]
    assert process.returncode == 3


def test_the_image_finds_it_first() -> None:
    """It lies in the folder of PATH before the one of the program itself, and nothing else hides it."""
    text = (ROOT / "docker" / "Dockerfile").read_text("utf-8")
    place = re.search(r"^COPY docker/phm (\S+)/phm$", text, re.MULTILINE)
    path = re.search(r"\bPATH=(\S+)", text)
    assert place is not None
    assert path is not None
    assert path[1].split(":")[:2] == [place[1], PROGRAM.rpartition("/")[0]]
    assert "!docker/phm" in (ROOT / ".dockerignore").read_text("utf-8").splitlines()
    assert os.access(ROOT / "docker" / "phm", os.X_OK)
