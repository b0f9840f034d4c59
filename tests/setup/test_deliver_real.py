"""Deliveries to PHM in a container, with the Compose files as shipped: refused without the opt-in, applied with it."""

from __future__ import annotations

import contextlib
import http.client
import json
import os
import socket
import subprocess
import sys
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml
from click.testing import CliRunner

from phm.cli import group
from phm.wire.delivery import version_of
from tests.fakes.mavlink import free_port
from tests.fakes.until import until
from tests.gcs.web.swarm import Client
from tests.runtime.test_deliver_real import LONG_LIMITS

ROOT = Path(__file__).parents[2]
APP_IMAGE = os.environ.get("PHM_TEST_APP_IMAGE", "phm-app:dev")
LIMIT_S = 300.0
TOKEN = "0123456789abcdef"
CHANGED = {"host": {"enabled": False}}
"""What is delivered: another section `checks`."""
AUTOPILOT = {
    "services": {
        "autopilot": {
            "image": APP_IMAGE,
            "command": [
                "python",
                "-m",
                "phm.simulation.autopilot",
                "--id",
                "3",
                "--companion",
                "udpin:0.0.0.0:14550",
                "--ground",
                "tcpin:0.0.0.0:5760",
            ],
            "healthcheck": {"disable": True},
            "mem_limit": "100m",
        }
    }
}
"""Nothing is delivered unless an autopilot is known to be disarmed."""


class Deployment:
    """PHM of Compose files. place: the folder of the command; files: the options that name them."""

    def __init__(self, place: Path, *files: str, **environ: str) -> None:
        image = os.environ.get("PHM_TEST_SIDECAR_IMAGE", "phm-sidecar:dev")
        self._place, self._environ = place, {"PHM_IMAGE": image, **environ}
        self._words = ("docker", "compose", "-p", f"phm-deliver-{uuid.uuid4().hex[:8]}", *files)

    def compose(self, *words: str, check: bool = True) -> str:
        kept = {name: value for name, value in os.environ.items() if not name.startswith("PHM_")}
        done = subprocess.run(
            [*self._words, *words],
            cwd=self._place,
            env={**kept, **self._environ},
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        )
        assert not check or done.returncode == 0, f"{words}: {done.stdout}{done.stderr}"
        return done.stdout

    def status(self) -> dict[str, Any]:
        with contextlib.suppress(ValueError):
            return dict(json.loads(self.compose("exec", "-T", "phm", "phm", "status", "--json", check=False)))
        return {}

    def disarmed(self) -> bool:
        return self.status().get("armed") is False

    def changed(self) -> bool:
        """Whether PHM runs with CHANGED: the computer is not checked."""
        units = [one["id"] for one in self.status().get("checks", ())]
        return bool(units) and not any(unit.startswith("host/") for unit in units)

    def seen(self) -> str:
        return f"{self.status().get('health')}\n{self.compose('logs', '--tail', '50', check=False)}"


@contextlib.contextmanager
def started(made: Deployment) -> Iterator[Deployment]:
    try:
        made.compose("up", "--detach")
        until(made.disarmed, "PHM with a disarmed autopilot", made.seen, limit_s=LIMIT_S, poll_s=0.5)
        yield made
    finally:
        made.compose("down", "--volumes", "--timeout", "3")


def owned_by_phm(folder: Path) -> None:
    """By the engine, which may change owners also if this test may not."""
    mount = f"{folder}:/folder"
    words = ["docker", "run", "--rm", "-u", "0", "-v", mount, "--entrypoint", "chown", APP_IMAGE]
    subprocess.run([*words, "-R", "10001:10001", "/folder"], check=True, timeout=LIMIT_S)


def configuration(**changed: Any) -> str:
    """For the agent of these tests, as text; a key without a value is left out."""
    base = {
        "agent": {"id": 3, "name": "A03"},
        "mavlink": {"endpoints": [{"url": "udpout:autopilot:14550", "leads_to": "both"}], "autopilot_timeout": 60},
    }
    return json.dumps({**base, **changed})


def secured(folder: str) -> dict[str, str]:
    """The section `delivery` for a key in this folder of the container."""
    return {"listen": "0.0.0.0:9465", "key": f"{folder}/delivery.key"}


@contextlib.contextmanager
def checks_page(folder: Path, file: Path, port: int, key: Path) -> Iterator[Client]:
    """`phm gcs --web --edit --deliver` as an operator starts it, logged in."""
    tokens, web = folder / "tokens", free_port()
    tokens.write_text(f"view: {TOKEN[::-1]}\noperate: {TOKEN}\n")
    tokens.chmod(0o600)
    options = ["--token-file", str(tokens), "--edit", str(file), "--deliver", str(file), f"127.0.0.1:{port}", str(key)]
    endpoint = f"udpin:127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    words = ["gcs", endpoint, "--web", str(web), "--history", "none", *options]
    path = os.pathsep.join((str(ROOT), str(ROOT / "checks")))
    process = subprocess.Popen(
        [sys.executable, "-c", LONG_LIMITS, *words],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": path},
    )
    client = Client(("127.0.0.1", web))

    def served() -> bool:
        assert process.poll() is None
        with contextlib.suppress(OSError, http.client.HTTPException):
            return client.login(TOKEN)[0] == 200
        return False

    try:
        until(served, "the page")
        yield client
    finally:
        process.kill()
        process.wait(LIMIT_S)


def deliver(client: Client, file: Path, text: str, base: str | None) -> Mapping[str, Any]:
    """Save a text and deliver it, as the buttons of the page do. base: the text that the agent has; None: whatever it has.

    On a machine that stalls, PHM does not trust the heartbeats that have waited meanwhile: deliver again after the next one.
    """
    opened = client.post("/api/config/open", {"name": str(file)})
    saved = {"name": str(file), "text": text, "version": opened["version"], "anyway": True}
    client.post("/api/config/save", saved)
    body = {"name": str(file), "version": version_of(text), "base": None if base is None else version_of(base)}
    answers: list[dict[str, Any]] = []

    def decided() -> bool:
        answers.append(dict(client.post("/api/config/deliver", body)))
        return answers[-1]["ok"] or "old heartbeats of the autopilot" not in answers[-1]["text"]

    until(decided, "an answer about the delivery", lambda: str(answers[-1:]), poll_s=1.0)
    return answers[-1]


def key_file(path: Path) -> Path:
    path.write_text("ab" * 32)
    path.chmod(0o600)
    return path


def with_autopilot(folder: Path) -> Path:
    path = folder / "autopilot.yaml"
    path.write_text(yaml.safe_dump(AUTOPILOT))
    return path


@pytest.mark.long
def test_with_the_overlay_a_delivery_from_the_page_is_applied_and_an_invalid_one_is_not(tmp_path: Path) -> None:
    """docker/compose.yaml with docker/compose.deliver.yaml: PHM reloads; what is invalid changes nothing; it survives a restart."""
    delivered, port = tmp_path / "delivered", free_port()
    delivered.mkdir()
    old = configuration(delivery=secured("/etc/phm-delivered"))
    (delivered / "phm.yaml").write_text(old)
    key, mine = key_file(tmp_path / "ground.key"), tmp_path / "mine.yaml"
    key_file(delivered / "delivery.key")
    mine.write_text(old)
    owned_by_phm(delivered)
    files = [str(ROOT / "docker" / name) for name in ("compose.yaml", "compose.deliver.yaml")]
    options = [word for file in (*files, str(with_autopilot(tmp_path))) for word in ("-f", file)]
    given = {"PHM_DELIVERED": str(delivered), "PHM_DELIVERY": f"127.0.0.1:{port}", "DOCKER_GID": "0"}
    volume = f"phm_deliver_{uuid.uuid4().hex[:8]}"
    with (
        started(Deployment(tmp_path, *options, **given, PHM_APP_VOLUME=volume)) as agent,
        checks_page(tmp_path, mine, port, key) as client,
    ):
        new = configuration(checks=CHANGED, delivery=secured("/etc/phm-delivered"))
        answer = deliver(client, mine, new, old)
        assert answer["ok"] and "configuration reloaded: checks" in answer["text"], answer
        until(agent.changed, "the new checks", agent.seen, poll_s=0.5)
        assert (delivered / "phm.yaml").read_text() == new

        until(agent.disarmed, "the next heartbeat of the autopilot", agent.seen, poll_s=0.5)
        invalid = configuration(containers="none", delivery=secured("/etc/phm-delivered"))
        answer = deliver(client, mine, invalid, new)
        assert not answer["ok"] and [each["key"] for each in answer["problems"]] == ["containers"], answer
        assert (delivered / "phm.yaml").read_text() == new and agent.changed()

        agent.compose("restart", "--timeout", "5", "phm")
        until(agent.changed, "PHM after a restart", agent.seen, poll_s=0.5)


@pytest.mark.long
def test_without_the_overlay_a_delivery_is_refused_with_what_permits_it(tmp_path: Path) -> None:
    """docker/compose.yaml alone, with a port and a key: the file is mounted read-only, and PHM cannot change it."""
    port, old, mine = free_port(), configuration(delivery=secured("/keys")), tmp_path / "mine.yaml"
    keys, file = tmp_path / "keys", tmp_path / "phm.yaml"
    keys.mkdir()
    key, _ = key_file(tmp_path / "ground.key"), key_file(keys / "delivery.key")
    mine.write_text(old)
    file.write_text(old)
    owned_by_phm(keys)
    published: dict[str, Any] = {"ports": [f"127.0.0.1:{port}:9465"], "volumes": [f"{keys}:/keys:ro"]}
    (tmp_path / "port.yaml").write_text(yaml.safe_dump({"services": {"phm": published}}))
    files = [str(ROOT / "docker" / "compose.yaml"), str(with_autopilot(tmp_path)), str(tmp_path / "port.yaml")]
    options = [word for name in files for word in ("-f", name)]
    volume = f"phm_deliver_{uuid.uuid4().hex[:8]}"
    with (
        started(Deployment(tmp_path, *options, PHM_CONFIG=str(file), DOCKER_GID="0", PHM_APP_VOLUME=volume)) as agent,
        checks_page(tmp_path, mine, port, key) as client,
    ):
        answer = deliver(client, mine, configuration(checks=CHANGED, delivery=secured("/keys")), old)
        assert not answer["ok"] and "/etc/phm/phm.yaml cannot be replaced" in answer["text"]
        for words in (
            "-f docker/compose.deliver.yaml",
            "- FOLDER:/etc/phm-delivered",
            "PHM_CONFIG: /etc/phm-delivered",
        ):
            assert words in answer["text"]
        assert file.read_text() == old and not agent.changed()


@pytest.mark.long
def test_the_folder_of_phm_init_takes_deliveries_on_request(tmp_path: Path) -> None:
    """`phm init --deliver`, then `docker compose up -d` in the folder, as it says."""
    port, place = free_port(), tmp_path / "phm"
    words = ["--yes", "--no-ros", "--id", "3", "--network", "bridge", "--mavlink", "udpout:autopilot:14550"]
    result = CliRunner().invoke(group, ["init", str(place), *words, "--deliver", f"127.0.0.1:{port}"])
    assert result.exit_code == 0, result.output
    written = place / "delivered" / "phm.yaml"
    # Not the containers of this machine: they are those of other tests.
    old = yaml.safe_dump({**yaml.safe_load(written.read_text()), "containers": []})
    written.write_text(old)
    key, mine = tmp_path / "ground.key", tmp_path / "mine.yaml"
    key.write_bytes((place / "delivered" / "delivery.key").read_bytes())
    key.chmod(0o600)
    mine.write_text(old)
    owned_by_phm(place / "delivered")
    options = [word for name in ("compose.yaml", "compose.override.yaml") for word in ("-f", name)]
    with (
        started(Deployment(place, *options, "-f", str(with_autopilot(tmp_path)))) as agent,
        checks_page(tmp_path, mine, port, key) as client,
    ):
        new = yaml.safe_dump({**yaml.safe_load(old), "checks": CHANGED})
        answer = deliver(client, mine, new, old)
        assert answer["ok"], answer
        until(agent.changed, "the new checks", agent.seen, poll_s=0.5)
        assert written.read_text() == new and "delivered" in agent.compose("exec", "-T", "phm", "env")
