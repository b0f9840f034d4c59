"""The images and compose files are what an agent runs: their properties are verified with the engine itself."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path
from typing import Any

import pytest

from phm.config.loader import DELIVERED as DELIVERED_AT
from tests.docs.blocks import containing
from tests.setup.test_template_renderer import made

ROOT = Path(__file__).resolve().parents[2]
LIMIT_S = 180.0
pytestmark = pytest.mark.engine


def docker(*words: str, **given: str) -> str:
    """Standard output of a docker command that must succeed, run without our environment variables except those given."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PHM_", "DOCKER_GID"))}
    environment |= given
    done = subprocess.run(
        ["docker", *words], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=LIMIT_S, check=False
    )
    assert done.returncode == 0, f"docker {' '.join(words)} ended with {done.returncode}:\n{done.stderr}"
    return done.stdout


def image(name: str) -> dict[str, Any]:
    (found,) = json.loads(docker("image", "inspect", name))
    config: dict[str, Any] = found["Config"]
    return config


def compose(*files: str, project: str = "phm", **given: str) -> dict[str, Any]:
    """The resolved configuration of compose files in docker/. given: variables of the environment."""
    words = [word for name in files for word in ("--file", f"docker/{name}")]
    resolved: dict[str, Any] = json.loads(
        docker("compose", "--project-name", project, *words, "config", "--format", "json", **given)
    )
    return resolved


def in_sidecar(*words: str) -> str:
    """Run a program in a new sidecar container with the minimal options of the compose file."""
    least = (
        "--rm",
        "--read-only",
        "--tmpfs",
        "/tmp",
        "--cap-drop",
        "ALL",
        "--network",
        "none",
        "--user",
        "10001:10001",
    )
    return docker("run", *least, "--entrypoint", words[0], "phm-sidecar:dev", *words[1:])


def test_the_sidecar_is_not_root_and_has_a_healthcheck() -> None:
    """The image runs `phm run` as user 10001, ends on SIGTERM and has the fast healthcheck."""
    config = image("phm-sidecar:dev")
    assert config["User"] == "10001:10001"
    assert [*config["Entrypoint"], *config["Cmd"]] == ["ros-entrypoint", "phm", "run"]
    assert config["StopSignal"] == "SIGTERM"
    assert config["Healthcheck"]["Test"] == ["CMD", "python", "-I", "-S", "/opt/phm/code/phm/wire/status_file.py"]


def test_the_sidecar_has_no_tools_to_build_or_download() -> None:
    """The image has neither pip nor a compiler, nor the certificates that the build may have needed."""
    found = in_sidecar(
        "sh", "-c", "for name in pip pip3 gcc cc make git curl wget; do command -v $name; done; ls -d /build || true"
    )
    assert found.strip() == ""


def test_the_sidecar_finds_ros_and_every_check() -> None:
    """With a read-only root and no capabilities, rclpy imports in the image and every entry point loads."""
    assert in_sidecar("python", "-c", "import rclpy; print(rclpy.__name__)").strip() == "rclpy"
    entries = json.loads(in_sidecar("phm", "checks", "--json"))
    assert entries
    assert [entry["problem"] for entry in entries if entry["problem"]] == []


def test_the_sidecar_keeps_no_columns_of_instructions_in_memory() -> None:
    """They took 3 MB. Tracebacks still have their line numbers."""
    program = "from phm.tracker.rules import decide; print([p for p in decide.__code__.co_positions() if p[0]][0])"
    line, *columns = in_sidecar("python", "-c", program).strip("()\n").split(", ")
    assert int(line) > 0
    assert columns[-2:] == ["None", "None"]


def test_the_ros_child_is_restricted_in_the_sidecar() -> None:
    """With the engine's default seccomp profile, as an ordinary user and read-only, every restriction is active."""
    code = "from phm.probes.ros import sandbox; print(repr(sandbox.enter()))"
    assert in_sidecar("python", "-c", code).strip() == "''"


def test_the_application_can_be_made_unhealthy() -> None:
    """The healthcheck of the demo application is cheap and fast, and fails while the marker file exists."""
    check = image("phm-app:dev")["Healthcheck"]
    assert check["Test"] == ["CMD", "test", "!", "-e", "/tmp/unhealthy"]
    assert check["Interval"] * check["Retries"] <= 2_000_000_000


def test_compose_gives_the_sidecar_least_privilege() -> None:
    """compose.yaml: no root, only log, state and memory writable, no capabilities, limits, restarted when it ends."""
    service = compose("compose.yaml")["services"]["phm"]
    assert service["user"] == "10001:10001"
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert service["restart"] == "unless-stopped"
    assert "privileged" not in service
    assert "cap_add" not in service
    assert int(service["mem_limit"]) > 0
    assert int(service["pids_limit"]) > 0
    writable = {mount["target"] for mount in service["volumes"] if not mount.get("read_only")}
    assert writable == {"/var/run/docker.sock", "/var/log/phm", "/var/lib/phm"}


def test_the_interval_of_the_configuration_applies_unless_the_environment_sets_one() -> None:
    """A blank value counts as not set."""
    assert not compose("compose.yaml")["services"]["phm"]["environment"]["PHM_INTERVAL"]
    assert compose("compose.yaml", PHM_INTERVAL="5s")["services"]["phm"]["environment"]["PHM_INTERVAL"] == "5s"


def permitted(service: dict[str, Any]) -> tuple[str, list[tuple[str, str, int]], list[str]]:
    """Folder of the host and published ports of a service that takes deliveries, and its writable targets below /etc."""
    mounts = {volume["target"]: volume for volume in service["volumes"] if volume["target"].startswith("/etc/")}
    assert service["environment"]["PHM_CONFIG"] == f"{DELIVERED_AT}/phm.yaml"
    ports = [(port["host_ip"], str(port["published"]), port["target"]) for port in service["ports"]]
    writable = [target for target, volume in mounts.items() if not volume.get("read_only", False)]
    return mounts[DELIVERED_AT]["source"], ports, writable


@pytest.mark.parametrize("written", [True, False], ids=["phm init --deliver", "docs"])
def test_the_override_for_deliveries_adds_one_writable_folder(tmp_path: Path, written: bool) -> None:
    """Compose itself merges it with what `phm init` writes; that of `phm init --deliver` and that of checks-page.md do the same."""
    (block,) = (
        block for block in containing("yaml", f":{DELIVERED_AT} #") if block.page == "docs/guides/checks-page.md"
    )
    texts = made(deliver=("10.0.0.7", 9465)) if written else {**made(), "compose.override.yaml": block.text}
    for name, text in texts.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    words = ("--project-directory", str(tmp_path), "--file", str(tmp_path / "compose.yaml"))
    merged = docker("compose", *words, "--file", str(tmp_path / "compose.override.yaml"), "config", "--format", "json")
    found = permitted(json.loads(merged)["services"]["phm"])
    assert found == (str(tmp_path / "delivered"), [("10.0.0.7", "9465", 9465)], [DELIVERED_AT])


def test_the_overlay_for_deliveries_adds_one_writable_folder() -> None:
    """The rest of compose.yaml stays; without a folder and an address, Compose refuses."""
    given = {"PHM_DELIVERED": "/opt/phm/delivered", "PHM_DELIVERY": "10.0.0.7:9465"}
    plain = compose("compose.yaml")["services"]["phm"]
    service = compose("compose.yaml", "compose.deliver.yaml", **given)["services"]["phm"]
    assert permitted(service) == ("/opt/phm/delivered", [("10.0.0.7", "9465", 9465)], [DELIVERED_AT])
    changed = {key for key in service if service[key] != plain.get(key)}
    assert changed == {"environment", "volumes", "ports"}
    rules = compose("compose.yaml", "compose.deliver.yaml", "compose.proxy.yaml", **given)["services"]["proxy_rules"]
    assert "PHM_CONFIG" not in rules["environment"]
    for name in given:
        with pytest.raises(AssertionError, match=name):
            compose("compose.yaml", "compose.deliver.yaml", **{**given, name: ""})


def test_every_setting_of_the_agent_is_in_the_example() -> None:
    """agent.env.example names each variable of compose.yaml, with the same default."""
    text = (ROOT / "docker" / "compose.yaml").read_text("utf-8")
    example = dict(
        line.split("=", 1)
        for line in (ROOT / "docker" / "agent.env.example").read_text("utf-8").splitlines()
        if line and not line.startswith("#")
    )
    taken = dict(piece.partition("}")[0].split(":-", 1) for piece in text.split("${")[1:])
    assert taken == example


def test_the_demo_extends_the_same_service() -> None:
    """With compose.demo.yaml the sidecar keeps its restrictions and gets an application and an autopilot to monitor."""
    plain, demo = compose("compose.yaml"), compose("compose.yaml", "compose.demo.yaml")
    assert set(demo["services"]) == {"phm", "ros_app", "autopilot"}
    for key in ("user", "read_only", "cap_drop", "security_opt", "restart", "mem_limit", "tmpfs"):
        assert demo["services"]["phm"][key] == plain["services"]["phm"][key]
