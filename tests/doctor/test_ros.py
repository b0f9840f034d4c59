"""`phm doctor`: ROS of PHM and of the application."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import pytest

from phm.doctor.ros import rows
from tests.doctor.places import doctor_context, row, states
from tests.fakes.engine import FakeEngine
from tests.setup.machines import described

JAZZY = {"distribution": "jazzy", "rclpy": "7.1.4", "middleware": "rmw_fastrtps_cpp", "middleware_version": "8.4.2"}


def installed(monkeypatch: pytest.MonkeyPatch, found: dict[str, str] | None, error: str = "") -> None:
    """What the child process prints; None: it fails with this error."""

    def run(*_: Any, **__: Any) -> subprocess.CompletedProcess[bytes]:
        text = json.dumps(found).encode() if found else b""
        return subprocess.CompletedProcess([], 0 if found else 1, text, error.encode())

    monkeypatch.setattr(subprocess, "run", run)


def test_the_installation_of_phm_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The rows have distribution, rclpy, middleware with their versions, and domain."""
    installed(monkeypatch, JAZZY)
    found = list(rows(doctor_context(tmp_path, ros={"domain": 7})))
    assert row(found, "PHM").text == "jazzy, rclpy 7.1.4, rmw_fastrtps_cpp 8.4.2"
    assert "ROS_DOMAIN_ID 7" in row(found, "domain").text


def test_no_rclpy_is_missing_where_nodes_are_configured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Elsewhere it only limits."""
    installed(monkeypatch, None)
    found = list(rows(doctor_context(tmp_path)))
    assert states(found)["PHM"] == "limited"
    assert "install the extra 'ros' (in a clone of PHM: pip install '.[ros]')" in row(found, "PHM").remedy
    assert states(list(rows(doctor_context(tmp_path, ros={"nodes": [{"name": "/a"}]}))))["PHM"] == "missing"


def test_a_middleware_that_cannot_be_loaded_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the last line of the error. Without rclpy it is not the middleware that is missing."""
    installed(monkeypatch, None, "Traceback ...\n  File ...\nRMWError: librmw_cyclonedds_cpp.so: no such\x1b file\n")
    there = doctor_context(tmp_path, environ={"RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"})
    found = row(list(rows(there)), "PHM")
    expected = "rclpy cannot load rmw_cyclonedds_cpp: RMWError: librmw_cyclonedds_cpp.so: no such\\x1b file"
    assert found.text == expected and "BASE_IMAGE" in found.remedy
    installed(monkeypatch, None, "ModuleNotFoundError: No module named 'rclpy'\n")
    assert "install the extra 'ros'" in row(list(rows(there)), "PHM").remedy


def test_an_application_with_other_variables_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The row names the difference and the line to change."""
    installed(monkeypatch, JAZZY)
    with FakeEngine(tmp_path / "engine.sock") as fake:
        fake.containers["same"] = described("same", env={"ROS_DOMAIN_ID": "7", "ROS_DISTRO": "jazzy"})
        fake.containers["other"] = described("other", env={"ROS_DOMAIN_ID": "8"})
        there = doctor_context(tmp_path, docker={"socket": fake.url}, environ={"ROS_DOMAIN_ID": "7"})
        found = list(rows(there))
    assert row(found, "same").state == "ok"
    assert row(found, "other").state == "limited"
    assert "ROS_DOMAIN_ID" in row(found, "other").text


def test_the_remedy_is_a_complete_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where it names a line of a YAML file, which has a colon."""
    installed(monkeypatch, JAZZY)
    with FakeEngine(tmp_path / "engine.sock") as fake:
        fake.containers["app"] = described("app", env={"ROS_DOMAIN_ID": "8"})
        there = doctor_context(tmp_path, docker={"socket": fake.url}, ros={"domain": 7})
        found = row(list(rows(there)), "app")
    assert found.remedy == "set ros.domain: 8 in phm.yaml" and found.text.endswith("and 7 in PHM")


def test_on_the_host_the_sidecar_is_compared(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not the shell in which `phm doctor` runs."""
    installed(monkeypatch, JAZZY)
    with FakeEngine(tmp_path / "engine.sock") as fake:
        fake.containers["app"] = described("app", env={"ROS_DOMAIN_ID": "8"})
        sidecar = {"ROS_DOMAIN_ID": "8", "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
        fake.containers["phm"] = described("phm", env=sidecar, entrypoint=["ros-entrypoint", "phm"])
        there = doctor_context(tmp_path, docker={"socket": fake.url}, environ={"ROS_DOMAIN_ID": "7"})
        found = list(rows(there))
    assert row(found, "app").state == "ok" and "ROS_DOMAIN_ID 8" in row(found, "domain").text
