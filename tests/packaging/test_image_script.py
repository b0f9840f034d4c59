"""scripts/image with a fake `docker`: what it refuses, and what it needs of the engine."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("targets", [(), ("sidecar",), ("proxy", "app")])
def test_on_arm64_a_base_image_is_required(targets: tuple[str, ...], tmp_path: Path) -> None:
    """The wheels of rclpy exist for x86-64 only."""
    for name, answer in (("uname", "echo aarch64"), ("docker", "exit 0")):
        (tmp_path / name).write_text(f"#!/bin/sh\n{answer}\n")
        (tmp_path / name).chmod(0o755)
    environment = {name: value for name, value in os.environ.items() if name != "BASE_IMAGE"}
    environment["PATH"] = f"{tmp_path}:{environment['PATH']}"
    done = subprocess.run(
        ["scripts/image", *targets], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == (
        "phm: on arm64 rclpy comes from the base image: set BASE_IMAGE, e.g. BASE_IMAGE=ros:jazzy-ros-core scripts/image sidecar\n"
    )


def test_the_base_image_may_be_known_to_the_builder_only(tmp_path: Path) -> None:
    """BuildKit pulls BASE_IMAGE into its own cache: afterwards the engine has no image of that name to tag."""
    for name in ("scripts/image", "scripts/lib.sh", "docker/Dockerfile"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        shutil.copy2(ROOT / name, tmp_path / name)
    engine = tmp_path / "bin" / "docker"
    engine.parent.mkdir()
    engine.write_text(
        '#!/bin/sh\ncase "$*" in *"-- ros:jazzy-ros-core" | tag\\ *) echo "No such image" >&2; exit 1 ;; esac\n'
    )
    engine.chmod(0o755)
    environment = {**os.environ, "BASE_IMAGE": "ros:jazzy-ros-core", "PATH": f"{engine.parent}:{os.environ['PATH']}"}
    done = subprocess.run(
        ["scripts/image", "sidecar"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert "Built phm-sidecar:dev" in done.stderr
    assert done.returncode == 0, done.stderr
