"""Deliveries from the Checks page: a real agent's port, and only the files, addresses and keys of the command line."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner

from phm.cli import group
from phm.gcs.web.config_delivery import ConfigDelivery, DeliveryTarget
from phm.gcs.web.config_editor import ConfigEditor
from phm.gcs.web.options import ListenOptions, Tokens
from phm.gcs.web.routes.checks import DELIVERY, EXTRA
from phm.runtime.configuration import plan_of
from phm.wire.delivery import version_of
from tests.commands.test_delivery_server import BASE, KEY, OTHER, Bench
from tests.fakes.until import until
from tests.gcs.web.swarm import Client, ground

TEXT = "agent: {id: 7}\n"


@pytest.fixture
def agent() -> Iterator[Bench]:
    made = Bench()
    yield made
    made.go.set()
    made.server.close()


@pytest.fixture
def file(tmp_path: Path) -> Path:
    made = tmp_path / "a7.yaml"
    made.write_text(TEXT)
    return made


@contextmanager
def page(agent: Bench, *files: Path, key: bytes = KEY, tokens: Tokens | None = None) -> Iterator[Client]:
    """The agent is that of the first file."""
    sender = ConfigDelivery({str(files[0]): DeliveryTarget(*agent.where, key)})
    extra = {EXTRA: ConfigEditor(plan_of, [str(each) for each in files]), DELIVERY: sender}
    with ground(ListenOptions(port=0, tokens=tokens), extra=extra) as made:
        client = made.client()
        client.session()
        yield client


def test_the_saved_file_is_delivered(agent: Bench, file: Path) -> None:
    """With the version that it was made from; the page gets the agent's answer."""
    with page(agent, file) as client:
        assert client.get("/api/config")["agents"] == {str(file): "{}:{}".format(*agent.where)}
        body = {"name": str(file), "version": version_of(TEXT), "base": BASE}
        got = client.post("/api/config/deliver", body)
        assert (got["ok"], got["agent"], got["problems"]) == (True, "A07", [])
        assert agent.executed == [(TEXT, BASE, "127.0.0.1")]


def test_an_operator_may_replace_whatever_the_agent_has(agent: Bench, file: Path) -> None:
    """Then the agent is asked for its version first."""
    with page(agent, file) as client:
        body = {"name": str(file), "version": version_of(TEXT), "base": None}
        assert client.post("/api/config/deliver", body)["ok"]
    assert [(text, base) for text, base, _ in agent.executed] == [("", version_of("")), (TEXT, version_of(""))]


def test_only_what_is_on_disk_is_delivered(agent: Bench, file: Path) -> None:
    """Not a text of the browser, and not what another program has written meanwhile."""
    with page(agent, file) as client:
        body = {"name": str(file), "version": version_of(TEXT), "base": BASE}
        file.write_text("agent: {id: 8}\n")
        assert "another program" in client.post("/api/config/deliver", body, 409)["error"]
        client.post("/api/config/deliver", {"name": str(file)}, 400)
        client.post("/api/config/deliver", {**body, "base": 7}, 400)
    assert agent.executed == []


def test_other_files_have_no_agent(agent: Bench, file: Path, tmp_path: Path) -> None:
    """Neither another file of --edit nor one of this computer."""
    other = tmp_path / "a8.yaml"
    other.write_text(TEXT)
    with page(agent, file, other) as client:
        for name in (str(other), "/etc/passwd"):
            client.post("/api/config/deliver", {"name": name, "version": version_of(TEXT), "base": BASE}, 404)
    assert agent.executed == []


def test_a_refusal_is_shown_with_its_reason(agent: Bench, file: Path) -> None:
    """Of the agent, of a wrong key, and of an agent that cannot be reached."""
    body = {"name": str(file), "version": version_of(TEXT), "base": BASE}
    with page(agent, file, key=OTHER) as client:
        got = client.post("/api/config/deliver", body)
        assert not got["ok"] and "key" in got["text"]
    agent.server.close()
    with page(agent, file) as client:
        assert "refused" in client.post("/api/config/deliver", body, 409)["error"]


def test_one_delivery_at_a_time(agent: Bench, file: Path) -> None:
    """Each keeps a thread of the page's server, which serves everything else meanwhile."""
    agent.go.clear()
    body = {"name": str(file), "version": version_of(TEXT), "base": BASE}
    with page(agent, file) as client:
        thread = threading.Thread(target=lambda: client.post("/api/config/deliver", body), daemon=True)
        thread.start()
        until(lambda: agent.executed, "the first one")
        assert "another configuration" in client.post("/api/config/deliver", body, 409)["error"]
        assert client.get("/api/config")["edit"]
        agent.go.set()
        thread.join(60)


def test_only_an_operator_delivers(agent: Bench, file: Path) -> None:
    """The role view may not, and a page without log-in neither."""
    body = {"name": str(file), "version": version_of(TEXT), "base": BASE}
    with page(agent, file, tokens=Tokens("v" * 32, "o" * 32)) as client:
        client.post("/api/config/deliver", body, 401)
        assert client.login("v" * 32)[0] == 200
        client.post("/api/config/deliver", body, 403)
        assert client.login("o" * 32)[0] == 200
        assert client.post("/api/config/deliver", body)["ok"]
    assert len(agent.executed) == 1


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--deliver", "a.yaml", "10.0.0.7:9465", "k"], "add --edit a.yaml"),
        (["--edit", "a.yaml", "--deliver", "a.yaml", "10.0.0.7:9465", "k"], "needs --token-file"),
        (["--edit", "a.yaml", *("--deliver", "a.yaml", "10.0.0.7:9465", "k") * 2], "names a.yaml twice"),
        (["--edit", "a.yaml", "--deliver", "a.yaml", "10.0.0.7", "k", "--token-file", "tokens"], "HOST:PORT"),
        (
            ["--edit", "a.yaml", "--deliver", "a.yaml", "10.0.0.7:9465", "missing.key", "--token-file", "tokens"],
            "--deliver: missing.key cannot be read",
        ),
        (
            ["--edit", "a.yaml", "--deliver", "a.yaml", "10.0.0.7:9465", "open.key", "--token-file", "tokens"],
            "chmod 600",
        ),
    ],
)
def test_mistakes_on_the_command_line_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], said: str
) -> None:
    """Before anything listens."""
    monkeypatch.chdir(tmp_path)
    Path("a.yaml").write_text(TEXT)
    Path("tokens").write_text("operate: 0123456789abcdef0123")
    Path("tokens").chmod(0o600)
    Path("open.key").write_text("ab" * 32)
    Path("open.key").chmod(0o644)
    done = CliRunner().invoke(group, ["gcs", "--once", "--for", "0.1", "--web", "0", "--history", "none", *options])
    assert done.exit_code in (1, 2) and said in done.output.replace("\n", " "), done.output
