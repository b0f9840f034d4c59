"""scripts/image stops where it would build an image without rclpy."""

from __future__ import annotations

import os
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
