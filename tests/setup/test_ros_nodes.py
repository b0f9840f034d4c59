"""How `phm init` reads the ROS graph with the application's variables."""

from __future__ import annotations

import subprocess
from typing import Any

import pytest

from phm.setup import ros_nodes


def test_configuration_of_the_middleware_does_not_come_from_the_application(monkeypatch: pytest.MonkeyPatch) -> None:
    """An image could name a file to be written, with the rights of the user of `phm init`."""
    seen: dict[str, str] = {}

    def run(argv: Any, env: dict[str, str], **_: Any) -> subprocess.CompletedProcess[bytes]:
        seen.update(env)
        return subprocess.CompletedProcess(argv, 0, b'{"nodes": ["/a/b"]}', b"")

    monkeypatch.setattr(subprocess, "run", run)
    for name in ("CYCLONEDDS_URI", "FASTRTPS_DEFAULT_PROFILES_FILE"):
        monkeypatch.delenv(name, raising=False)
    given = {"ROS_DOMAIN_ID": "7", "CYCLONEDDS_URI": "<Tracing/>", "FASTRTPS_DEFAULT_PROFILES_FILE": "/x"}
    assert ros_nodes.nodes(given) == ("/a/b",)
    assert seen["ROS_DOMAIN_ID"] == "7"
    assert not {"CYCLONEDDS_URI", "FASTRTPS_DEFAULT_PROFILES_FILE"} & seen.keys()
