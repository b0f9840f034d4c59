"""The Checks page without a browser: what the server reads, checks and writes."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from phm.gcs.web.config_editor import ConfigEditor
from phm.gcs.web.options import ListenOptions, Tokens
from phm.gcs.web.routes.checks import EXTRA
from phm.runtime.configuration import plan_of
from tests.gcs.web.swarm import Client, Ground, ground

TEXT = """\
# The bench.
agent: {name: "${NAME}", id: 7}
containers:
  - name: app  # ours
"""
NAMED = {"NAME": "a7"}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "agent.yaml"
    path.write_text(TEXT)
    path.chmod(0o640)
    return path


@contextlib.contextmanager
def page(*files: Path, tokens: Tokens | None = None) -> Iterator[tuple[Ground, Client]]:
    editor = ConfigEditor(plan_of, [str(path) for path in files])
    with ground(ListenOptions(port=0, tokens=tokens), extra={EXTRA: editor}) as made:
        yield made, made.client()


@pytest.fixture
def client(file: Path) -> Iterator[Client]:
    with page(file) as (_, made):
        made.session()
        yield made


def check(client: Client, text: str, *edits: dict[str, Any], **more: Any) -> dict[str, Any]:
    body = {"text": text, "base": TEXT, "edits": list(edits), "variables": NAMED, **more}
    return dict(client.post("/api/config/check", body))


def test_an_edit_gives_text_values_units_and_diff(client: Client) -> None:
    """The new units are marked, the comments stay, and nothing is written."""
    edit = {"do": "add", "path": ["ros", "nodes"], "value": {"name": "/a7/nav"}}
    got = check(client, TEXT, edit)
    assert got["problems"] == [] and got["refused"] == ""
    assert got["text"] == TEXT + "ros:\n  nodes:\n    - name: /a7/nav\n"
    assert got["values"]["ros"] == {"nodes": [{"name": "/a7/nav"}]}
    assert got["values"]["agent"]["name"] == "${NAME}"
    changes = {row["unit"]: row["change"] for row in got["units"]}
    assert changes["nodes/a7/nav"] == "new"
    assert changes["container/app"] == ""
    needs = next(row["needs"] for row in got["units"] if row["unit"] == "nodes/a7/nav")
    assert "container/app" in needs
    assert "+    - name: /a7/nav" in got["diff"].splitlines()


def test_problems_are_those_of_phm_validate(client: Client) -> None:
    """With line and key; edits go on meanwhile."""
    got = check(client, TEXT, {"do": "set", "path": ["interval"], "value": "0s"})
    assert [(one["line"], one["key"]) for one in got["problems"]] == [(5, "interval")]
    assert "allowed is 1 to 3600 seconds" in got["problems"][0]["message"]
    assert got["units"] == [] and got["usable"]
    assert check(client, "a: [\n")["usable"] is False


def test_variables_are_those_that_are_given(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    """The environment of the ground's computer may have secrets, so it does not count."""
    monkeypatch.setenv("NAME", "secret-of-the-ground")
    got = check(client, TEXT, variables={})
    assert got["problems"][0]["message"].startswith("${NAME} is not set")
    assert "secret-of-the-ground" not in str(got)


def test_an_edit_that_is_not_possible_is_refused_with_the_reason(client: Client) -> None:
    """And changes nothing."""
    got = check(client, TEXT, {"do": "remove", "path": ["containers", 4]})
    assert "is not in the configuration" in got["refused"] and got["text"] == TEXT


def test_saving_writes_only_a_file_that_is_as_it_was_read(client: Client, file: Path) -> None:
    """Atomically, with its permissions; a change by another program in between is not overwritten."""
    opened = client.post("/api/config/open", {"name": str(file)})
    assert opened["text"] == TEXT
    body = {"name": str(file), "text": TEXT + "interval: 10s\n", "version": opened["version"], "variables": NAMED}
    saved = client.post("/api/config/save", body)
    assert file.read_text() == TEXT + "interval: 10s\n"
    assert file.stat().st_mode & 0o777 == 0o640
    assert list(file.parent.iterdir()) == [file]
    assert "changed by another program" in client.post("/api/config/save", body, 409)["error"]
    client.post("/api/config/save", {**body, "text": TEXT, "version": saved["version"]})
    assert file.read_text() == TEXT


def test_problems_are_saved_only_on_request_and_broken_yaml_never(client: Client, file: Path) -> None:
    """A check that is installed on the agent alone is a problem here."""
    version = client.post("/api/config/open", {"name": str(file)})["version"]
    body = {"name": str(file), "version": version, "variables": NAMED}
    wrong = {**body, "text": TEXT + "checks: {theirs: {}}\n"}
    assert "unknown check" in client.post("/api/config/save", wrong, 409)["error"]
    assert "not correct" in client.post("/api/config/save", {**body, "text": "a: [", "anyway": True}, 409)["error"]
    client.post("/api/config/save", {**wrong, "anyway": True})
    assert "theirs" in file.read_text()


@pytest.mark.parametrize("name", ["/etc/passwd", "other.yaml", "../agent.yaml", ""])
def test_no_other_file_is_opened_or_written(client: Client, file: Path, name: str) -> None:
    """Only those of `--edit`, by the name given there."""
    (file.parent / "other.yaml").write_text(TEXT)
    client.post("/api/config/open", {"name": name}, 404)
    client.post("/api/config/save", {"name": name, "text": TEXT, "version": ""}, 404)


def test_a_link_that_changes_later_leads_nowhere_else(file: Path) -> None:
    """It is followed once, at the start."""
    link, other = file.parent / "link.yaml", file.parent / "other.yaml"
    link.symlink_to(file)
    editor = ConfigEditor(plan_of, [str(link)])
    other.write_text("agent: {id: 9}\n")
    link.unlink()
    link.symlink_to(other)
    assert editor.open(str(link))["text"] == TEXT


def test_a_link_in_the_place_of_the_file_leads_nowhere_else(client: Client, file: Path) -> None:
    """Who can write the folder could otherwise have any file shown, and written."""
    other = file.parent / "secret.yaml"
    other.write_text("agent: {id: 9}\n")
    version = client.post("/api/config/open", {"name": str(file)})["version"]
    file.unlink()
    file.symlink_to(other)
    client.post("/api/config/open", {"name": str(file)}, 404)
    client.post("/api/config/save", {"name": str(file), "text": TEXT, "version": version, "variables": NAMED}, 404)
    assert other.read_text() == "agent: {id: 9}\n"


@pytest.mark.parametrize(
    "text", ["# " + "a" * 300_000 + "\n" + TEXT, TEXT + "# \ud800\n"], ids=["large", "half a character"]
)
def test_a_text_that_cannot_be_read_again_is_not_saved(client: Client, file: Path, text: str) -> None:
    """Else the file could not be opened any more."""
    version = client.post("/api/config/open", {"name": str(file)})["version"]
    body = {"name": str(file), "text": text, "version": version, "variables": NAMED, "anyway": True}
    status, answer, _ = client.ask("POST", "/api/config/save", body)
    assert (status // 100, file.read_text()) == (4, TEXT), answer
    assert "codec" not in answer["error"]


@pytest.mark.parametrize(
    "body",
    [
        {"text": 7},
        {"text": "a" * 300_000},
        {"text": TEXT, "edits": 3},
        {"text": TEXT, "edits": [{}] * 21},
        {"text": TEXT, "variables": ["x"]},
        {"text": TEXT, "variables": {"A": "x" * 5000}},
        {"text": "\ud800"},
    ],
)
def test_bodies_that_are_none_are_refused(client: Client, body: dict[str, Any]) -> None:
    """With a sentence."""
    assert client.post("/api/config/check", body, 400)["error"]


def test_only_an_operator_sees_a_configuration(file: Path) -> None:
    """It may have secrets; without a session nothing answers."""
    with page(file, tokens=Tokens("v" * 32, "o" * 32)) as (_, client):
        client.get("/api/config", 401)
        assert client.login("v" * 32)[0] == 200
        client.get("/api/config", 403)
        for path in ("open", "check", "save"):
            client.post(f"/api/config/{path}", {"name": str(file)}, 403)
