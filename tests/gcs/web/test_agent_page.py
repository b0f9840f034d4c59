"""`phm status --web`: the page of one agent, from its own status file."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from phm.cli import group
from phm.core.clock import SystemClock
from phm.gcs.web import agent_row
from phm.gcs.web.agent_page import AgentPage
from phm.gcs.web.options import ListenOptions, Tokens
from phm.wire import status_file, status_shape
from phm.wire.report import iso
from tests.docs.story import play
from tests.fakes.mavlink import free_port
from tests.fakes.until import until
from tests.gcs.web.swarm import Client, Live

CONFIGURATION = """
agent: {name: agent_7, id: 7}
run_dir: RUN
state_dir: RUN/state
log: {directory: RUN/log}
checks: {engine: {enabled: false}}
"""


OPENED_S = time.time() - 60.0


def document(**changes: Any) -> dict[str, Any]:
    """The status of an agent of which a node has been dead since a minute, as the daemon of this machine would have written it now."""
    place = {**status_file.place(), "pid": os.getpid(), "written_mono": time.monotonic()}
    found = {**json.loads(json.dumps(play().during, default=str)), **place, "alive": True}
    (fault,) = found["faults"]["open"]
    found["faults"]["open"] = [{**fault, "opened": iso(OPENED_S)}]
    return {**found, **changes, "agent_id": 7}


class Written:
    """A run_dir with a status, and its page."""

    def __init__(
        self, folder: Path, options: ListenOptions | None = None, history: Path | None = None, **changes: Any
    ) -> None:
        """changes: of the first status."""
        self._folder = folder
        self.write(document(**changes))
        self.page = AgentPage(self.observe, options or ListenOptions(port=0), SystemClock(), history)
        self.page.start()
        self.client = Client(self.page.server.address)
        until(self._serves, "the page")

    def _serves(self) -> bool:
        with contextlib.suppress(OSError), socket.create_connection(self.page.server.address, 5):
            return True
        return False

    def write(self, content: dict[str, Any]) -> None:
        self.write_text(json.dumps(content))

    def write_text(self, content: str) -> None:
        temporary = self._folder / "new"
        temporary.write_text(content)
        temporary.replace(self._folder / "status.json")

    def observe(self) -> tuple[dict[str, Any], str]:
        try:
            found = status_shape.read(str(self._folder))
        except status_file.NoStatus as error:
            return {}, str(error)
        return found, status_file.unhealthy(found)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Written]:
    """No daemon writes its status again, so it is current for longer than a test may take."""
    monkeypatch.setattr(status_file, "MAX_AGE_S", 3600.0)
    made = Written(tmp_path)
    yield made
    made.page.close()


def test_all_checks_of_the_agent_are_shown(here: Written) -> None:
    """Each unit with layer, slot, level, text and the moment since when; and the row has the keys of a row of the ground."""
    state = here.client.get("/api/state")
    assert state["ground"]["page"] == "status"
    (row,) = state["agents"].values()
    written = document()
    assert [one["unit"] for one in row["checks"]] == [one["id"] for one in written["checks"]]
    assert (row["name"], row["how"], row["presence"], row["rank"]) == ("A07", "ERROR", "alive", 0)
    dead = next(one for one in row["checks"] if one["level"] == "ERROR")
    assert dead["unit"] == "nodes/agent_1/node_1" and dead["slot"] == 6 and dead["at"] <= row["at"]
    assert row["slots"]["6"] == "ERROR" and "node_1" in row["bad"][0]["text"]
    assert next(hop for hop in row["hops"] if hop["name"] == "node")["state"] == "broken"
    blocked = next(one for one in row["checks"] if one["level"] == "STALE")
    assert "blocked by nodes/agent_1/node_1" in blocked["text"]


@pytest.mark.parametrize(
    ("level", "state"), [("OK", "ok"), ("STALE", "unknown"), ("n/a", "unknown"), (None, "unknown")]
)
def test_the_agent_knows_of_the_ground_only_what_it_receives(level: str | None, state: str) -> None:
    """Ground and radio are drawn as working only if a check of the agent says so."""
    others = [one for one in document()["checks"] if one["id"] not in ("gcs", "radio")]
    added = [
        {**others[0], "id": unit, "slot": slot, "level": level} for unit, slot in (("gcs", 1), ("radio", 11)) if level
    ]
    hops = {hop["name"]: hop["state"] for hop in agent_row.row(document(checks=[*others, *added]), "")["hops"]}
    assert (hops["ground"], hops["radio"], hops["computer"], hops["node"]) == (state, state, "ok", "broken")


def test_a_change_of_the_status_reaches_the_page(here: Written) -> None:
    """As a difference; a status that is gone makes the agent lost, with the reason."""
    live = Live(here.client)
    until(lambda: live.agent("A07"), "the row")
    here.write(document(checks=[], holds=[]))
    until(lambda: live.agent("A07")["checks"] == [], "the change")
    assert live.agent("A07")["how"] == "UNKNOWN"
    here.write(document(alive=False))
    until(lambda: live.agent("A07")["how"] == "LOST", "the stalled daemon")
    assert "stalled" in live.agent("A07")["problem"]
    (row,) = here.client.get("/api/state")["agents"].values()
    assert row["slots"] == {} and row["last_slots"]["6"] == "ERROR"
    live.close()


def test_a_closed_page_logs_no_error(here: Written, caplog: pytest.LogCaptureFixture) -> None:
    """A browser may leave at any time, without a traceback in the log."""
    for turn in range(20):
        live = Live(here.client)
        until(lambda: len(here.page.server.clients), "the client")
        here.write(document(status_word=turn))
        live.close()
        here.page.read()
    until(lambda: len(here.page.server.clients) == 0, "no clients", lambda: here.page.read())
    assert [record.getMessage() for record in caplog.records if record.levelname == "ERROR"] == []


def test_nothing_can_be_requested(here: Written) -> None:
    """Also by who may operate: the page is for looking."""
    here.client.session()
    status, body, _ = here.client.ask("POST", "/api/requests", {"agent": "A07", "do": "check"})
    assert status in (404, 409) and body["error"]
    status, body, _ = here.client.ask("GET", "/api/choices?agent=A07")
    assert status in (404, 409) or body["choices"] == []


def test_a_hostile_status_stays_text_and_is_bounded(here: Written) -> None:
    """What checks say is one line of bounded length, and markup is characters."""
    wicked = "</script><img src=x onerror=alert(1)>\n\x1b[2J\u202e" + "x" * 10_000
    checks = [{**one, "summary": wicked, "since": wicked} for one in document()["checks"]]
    here.write(document(checks=checks, agent_id=wicked, written_utc=wicked, boot_id=wicked))
    until(lambda: "img src" in json.dumps(here.client.get("/api/state")["agents"]), "the status")
    (row,) = here.client.get("/api/state")["agents"].values()
    for one in row["checks"]:
        assert len(one["text"]) <= agent_row.MAX_TEXT and one["at"] is None
        assert not {"\n", "\x1b"} & set(one["text"])


@pytest.mark.parametrize("moment", ["1e999", "-1e999", "true", '"x"', "null", "1" + "0" * 400])
def test_a_damaged_moment_is_unknown(here: Written, moment: str) -> None:
    """The page still answers, and says that the daemon is not healthy."""
    damaged = {**document(), "written_mono": "MOMENT"}
    here.write_text(json.dumps(damaged).replace('"MOMENT"', moment))
    until(lambda: next(iter(here.client.get("/api/state")["agents"].values()))["presence"] == "lost", "the status")
    (row,) = here.client.get("/api/state")["agents"].values()
    assert row["at"] is None and {one["at"] for one in row["checks"]} == {None}


def test_without_a_status_there_is_a_reason(tmp_path: Path) -> None:
    """A page can be started before the daemon."""
    row = agent_row.row({}, "there is no /run/phm/status.json")
    assert (row["how"], row["presence"], row["checks"], row["slots"]) == ("UNKNOWN", "never received", [], {})
    assert "status.json" in row["problem"]
    assert agent_row.ground({}, "gone")["problems"] == ["gone"]


def test_elsewhere_a_token_is_needed(tmp_path: Path) -> None:
    """With tokens, the state is for who has one; the page and what BlueOS asks have no data of the agent."""
    tokens = Tokens(view="v" * 16, operate="o" * 16)
    made = Written(tmp_path, ListenOptions(port=0, tokens=tokens, behind_proxy=True))
    try:
        made.client.get("/api/state", 401)
        assert made.client.login("v" * 16)[0] == 200
        assert made.client.get("/api/state")["agents"]
        assert "A07" not in json.dumps(Client(made.page.server.address).get("/register_service"))
    finally:
        made.page.close()


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["--web", "0.0.0.0:0"], "--token-file"),
        (["--web", "--json"], "Use only one of"),
        (["--token-file", "x"], "need --web"),
        (["--history", "x"], "need --web"),
        (["--web", "x"], "needs a port"),
    ],
)
def test_unsafe_or_useless_options_are_refused(words: list[str], reason: str) -> None:
    """With the remedy."""
    result = CliRunner().invoke(group, ["status", *words], prog_name="phm")
    assert result.exit_code != 0 and reason in result.output


def test_a_real_daemon_is_shown_until_it_ends(tmp_path: Path) -> None:
    """`phm run` and `phm status --web` as an operator starts them; SIGTERM ends the page."""
    run = str(tmp_path / "run")
    (tmp_path / "phm.yaml").write_text(CONFIGURATION.replace("RUN", run))
    port = free_port()
    started = [
        subprocess.Popen([sys.executable, "-m", "phm.cli", *words], cwd=tmp_path, stdout=output, stderr=output)
        for words in (
            ["run", "--config", str(tmp_path / "phm.yaml")],
            ["status", "--run-dir", run, "--web", str(port), "--history", "none"],
        )
        for output in [subprocess.DEVNULL]
    ]
    daemon, page = started
    client = Client(("127.0.0.1", port))

    def row() -> dict[str, Any]:
        with contextlib.suppress(OSError):
            return dict(next(iter(client.get("/api/state")["agents"].values())))
        return {}

    try:
        until(lambda: any(one["unit"] == "host/memory" for one in row().get("checks") or ()), "the checks", row)
        until(lambda: (one := row()).get("name") == "A07" and one["presence"] == "alive", "the agent", row)
        daemon.send_signal(signal.SIGTERM)
        until(lambda: row().get("presence") == "never received", "the end of the daemon", row)
        page.send_signal(signal.SIGTERM)
        assert page.wait(120) == 0
    finally:
        for process in started:
            process.kill()
            process.wait(120)
