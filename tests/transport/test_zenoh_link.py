"""Real Zenoh sessions on loopback: a router in a separate process, agents with the real reporter, a reader as any
client.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import zenoh

from phm.core.model import Level, Slot
from phm.wire.status_file import NAME, read
from sitl.simulation.fleet_agents import Agent, Crowd, Ticker
from sitl.simulation.fleet_router import Ground, Router, config, free_port
from tests.fakes.until import until

FLEET = "north"
LIMIT_S = 120.0
"""Bounds a failing test. On a machine with a load of 100 a daemon takes more than 30 s to start."""
LEASE_S = 120.0
"""Of the router, and of an agent whose connections are counted: a busy machine must not end one."""
LONG_LIMITS = """
import sys
from phm.core.closing import ShutdownSequence
from phm.runtime import daemon
from phm.transport import zenoh_link
step = ShutdownSequence.step
ShutdownSequence.step = lambda self, name, call, limit_s: step(self, name, call, 60.0)
daemon.STOP_S = zenoh_link.FAREWELL_S = 60.0
from phm.cli import main
main(sys.argv[1:])
"""
"""`phm` with a long time for each step of its end: on a busy machine PHM would exit before its last status has left."""


class Bench:
    """Processes and sessions that a test starts; all are ended by `close`."""

    def __init__(self) -> None:
        self.port = free_port()
        self._ends: list[Callable[[], Any]] = []

    @property
    def endpoint(self) -> str:
        return f"tcp/127.0.0.1:{self.port}"

    def later(self, end: Callable[[], Any]) -> None:
        self._ends.append(end)

    def router(self, **options: Any) -> Router:
        router = Router(self.port, **{"transport__link__tx__lease": int(1000 * LEASE_S), **options})
        self.later(router.kill)
        return router

    def ground(self) -> Ground:
        ground = Ground(self.endpoint, FLEET)
        self.later(ground.close)
        return ground

    def agent(self, name: str = "agent_1", **options: Any) -> Agent:
        agent = Agent(name, options.pop("endpoint", self.endpoint), FLEET, **{"deadline": 1, **options})
        ticker = Ticker([agent])
        self.later(agent.reporter.close)
        self.later(ticker.close)
        return agent

    def crowd(self, count: int, first: int = 0, **options: Any) -> Crowd:
        crowd = Crowd(self.endpoint, FLEET, first, count, **options)
        self.later(crowd.kill)
        return crowd

    def close(self) -> None:
        for end in reversed(self._ends):
            end()


@pytest.fixture
def bench() -> Iterator[Bench]:
    made = Bench()
    try:
        yield made
    finally:
        made.close()


def test_a_change_reaches_the_ground(bench: Bench) -> None:
    """Status and token appear; a fault and its end are received; a stopped PHM announces it and withdraws its token."""
    bench.router()
    ground, agent = bench.ground(), bench.agent()
    ground.wait(lambda g: "agent_1" in g.statuses and len(g.tokens) == 1)
    assert list(ground.tokens) == [("agent_1", agent.boot_id)]
    agent.tick()
    ground.wait(
        lambda g: g.statuses["agent_1"].levels[Slot.NODES] is Level.ERROR and g.statuses["agent_1"].open_faults == 1
    )
    agent.tick()
    ground.wait(
        lambda g: g.statuses["agent_1"].levels[Slot.NODES] is Level.OK and not g.statuses["agent_1"].open_faults
    )
    agent.reporter.close()
    ground.wait(lambda g: not g.tokens and g.statuses["agent_1"].state == "POWEROFF")
    assert not ground.refused


def test_a_late_reader_gets_the_state_immediately(bench: Bench) -> None:
    """A query is answered with the newest status, long before the next refresh; a stalled agent does not answer."""
    bench.router()
    agent = bench.agent(refresh="1h")
    until(lambda: agent.reporter.report()["published"], "the first publication")
    late = bench.ground()
    late.wait(lambda g: "agent_1" in g.statuses and len(g.tokens) == 1)
    agent.alive = False
    late.wait(lambda g: not g.tokens)
    replies = list(late.session.get(f"phm/{FLEET}/*/status", timeout=30.0))
    assert [reply for reply in replies if reply.ok is not None] == []


def test_an_agent_connects_whenever_the_router_appears(bench: Bench) -> None:
    """The agent starts without a router and reports it, connects when one appears, and again after a restart; nothing
    waits for it.
    """
    agent = bench.agent(refresh="1h", lease=LEASE_S)
    until(lambda: "Unable to connect" in agent.reporter.report()["error"], "the failed connection to be reported")
    assert ".rs" not in agent.reporter.report()["error"]
    until(agent.reporter.problem, "a problem to be reported")
    router = bench.router()
    until(lambda: agent.reporter.report()["connected"], "the connection")
    until(lambda: not agent.reporter.problem(), "the problem to end")
    ground = bench.ground()
    ground.wait(lambda g: "agent_1" in g.statuses)
    before = ground.statuses["agent_1"].sequence
    router.kill()
    until(lambda: not agent.reporter.report()["connected"], "the connection to be lost")
    ground.wait(lambda g: not g.tokens)
    agent.tick()
    until(agent.reporter.problem, "a problem to be reported")
    bench.router()
    # Changes made meanwhile are published after the reconnect, without waiting for a refresh. A reader that reconnected
    # later than the agent has missed them, and sends a query, as the contract requires.
    ground.wait(lambda g: bool(g.tokens))
    ground.ask()
    ground.wait(lambda g: g.statuses["agent_1"].open_faults == 1)
    assert ground.statuses["agent_1"].sequence > before
    assert agent.reporter.report()["connects"] == 2


def test_a_client_uses_the_router_that_answers(bench: Bench) -> None:
    """The first endpoint of the list is unreachable."""
    bench.router()
    agent = bench.agent(connect=[f"tcp/127.0.0.1:{free_port()}", bench.endpoint])
    until(lambda: agent.reporter.report()["connected"], "the connection")


def test_a_peer_needs_no_router(bench: Bench) -> None:
    """It listens, and a reader connects to it."""
    agent = bench.agent(mode="peer", connect=[], listen=[bench.endpoint])
    until(lambda: agent.reporter.report()["error"] == "no peer has connected", "the missing reader to be reported")
    ground = bench.ground()
    ground.wait(lambda g: "agent_1" in g.statuses and len(g.tokens) == 1)


def test_two_agents_of_one_name_are_detected(bench: Bench) -> None:
    """Each sees the other's token stay and reports it, until the other is gone."""
    bench.router()
    one = bench.agent(lease=1)
    until(lambda: one.reporter.report()["connected"], "the connection")
    other = bench.agent(lease=1)
    until(
        lambda: "another PHM is present" in one.reporter.problem() and other.reporter.problem(),
        "the duplicate name to be reported",
    )
    bystander = bench.agent("agent_2", lease=1)
    other.reporter.close()
    until(lambda: not one.reporter.problem(), "the problem to end")
    # On a busy machine its lease may just have ended, which is another problem.
    assert "another PHM is present" not in bystander.reporter.problem()


def test_a_killed_process_is_detected(bench: Bench) -> None:
    """Its connection ends with it, and the token immediately; POWEROFF was not sent."""
    bench.router()
    ground, crowd = bench.ground(), bench.crowd(3)
    ground.wait(lambda g: len(g.tokens) == 3 and len(g.statuses) == 3)
    crowd.process.send_signal(signal.SIGKILL)
    ground.wait(lambda g: not g.tokens)
    assert {status.state for status in ground.statuses.values()} == {"ACTIVE"}


def test_a_status_that_no_reader_could_have_received_is_published_again(bench: Bench) -> None:
    """The router knows of the first reader only after it was published, as it may after a reconnect on a busy machine."""
    bench.router()
    agent = bench.agent(refresh="1h")
    until(lambda: agent.reporter.report()["published"] >= 2, "the first publication, and its repetition")
    received: list[str] = []
    reader = zenoh.open(config("client", connect__endpoints=[bench.endpoint]))
    bench.later(reader.close)
    reader.declare_subscriber(f"phm/{FLEET}/*/status", lambda sample: received.append(str(sample.key_expr)))
    until(lambda: received, "the status without a query")


def test_a_hanging_process_is_detected_after_its_lease(bench: Bench) -> None:
    """Its connection stays open and silent; when it resumes, it is present again, with its state."""
    bench.router()
    ground, crowd = bench.ground(), bench.crowd(1, lease=1, refresh="1h")
    ground.wait(lambda g: len(g.tokens) == 1)
    os.kill(crowd.process.pid, signal.SIGSTOP)
    ground.wait(lambda g: not g.tokens)
    ground.statuses.clear()
    os.kill(crowd.process.pid, signal.SIGCONT)
    ground.wait(lambda g: len(g.tokens) == 1 and len(g.statuses) == 1)


def test_a_reader_follows_a_fleet_of_fifty(bench: Bench) -> None:
    """All are known to a reader, also to a late one; each change is received; all are missed when their process dies. The thread of
    Zenoh adds statuses meanwhile, so a copy is counted."""
    bench.router()
    ground = bench.ground()
    crowds = [bench.crowd(25), bench.crowd(25, first=25)]
    ground.wait(lambda g: len(g.tokens) == len(g.statuses) == 50)
    for crowd in crowds:
        crowd.tick(range(25))
    ground.wait(lambda g: sum(status.open_faults for status in list(g.statuses.values())) == 50)
    late = bench.ground()
    late.wait(lambda g: len(g.tokens) == 50 and sum(status.open_faults for status in list(g.statuses.values())) == 50)
    crowds[0].process.kill()
    ground.wait(lambda g: len(g.tokens) == 25)
    assert {name for name, _ in ground.tokens} == set(crowds[1].names)
    assert crowds[1].end() == 0
    ground.wait(lambda g: not g.tokens and all(g.statuses[name].state == "POWEROFF" for name in crowds[1].names))


def test_queries_of_others_cannot_fill_the_memory(bench: Bench) -> None:
    """Thousands of simultaneous queries do not harm the agent; those beyond its limit are not answered."""
    bench.router()
    agent, ground = bench.agent(), bench.ground()
    ground.wait(lambda g: "agent_1" in g.statuses)
    for _ in range(3000):
        ground.session.get(f"phm/{FLEET}/agent_1/status", lambda reply: None, timeout=1.0)
    agent.tick()
    ground.wait(lambda g: g.statuses["agent_1"].open_faults == 1)


def run_daemon(bench: Bench, folder: Path) -> subprocess.Popen[bytes]:
    text = (
        f"agent: {{name: real_1, id: 1}}\ninterval: 2s\nrun_dir: {folder}/run\nstate_dir: {folder}/state\n"
        f"log: {{directory: {folder}/log}}\nfleet: {{enabled: true, name: {FLEET}, connect: [{bench.endpoint}], deadline: 1s}}\n"
    )
    folder.joinpath("phm.yaml").write_text(text)
    process = subprocess.Popen((sys.executable, "-c", LONG_LIMITS, "run", "-c", str(folder / "phm.yaml")))
    bench.later(process.wait)
    bench.later(process.kill)
    return process


def test_the_daemon_reports_to_a_fleet(bench: Bench, tmp_path: Path) -> None:
    """It starts and reports without a router, warns, recovers when there is one, and is missed when it is killed."""
    daemon = run_daemon(bench, tmp_path)
    until(
        lambda: (
            (tmp_path / "run" / NAME).exists()
            and "does not reach" in str(read(str(tmp_path / "run"))["health"]["problems"])
        ),
        "the unreachable router to be reported",
    )
    assert read(str(tmp_path / "run"))["health"]["reporters"]["fleet"]["connected"] is False
    bench.router()
    ground = bench.ground()
    ground.wait(lambda g: "real_1" in g.statuses and g.statuses["real_1"].levels.get(Slot.COMPANION) is Level.OK)
    until(lambda: read(str(tmp_path / "run"))["health"]["reporters"]["fleet"]["connected"], "the connection")
    daemon.kill()
    ground.wait(lambda g: not g.tokens)
    daemon.wait()
    # Its successor has another boot id, and announces its shutdown.
    second = run_daemon(bench, tmp_path)
    ground.wait(lambda g: bool(g.tokens))
    second.terminate()
    assert second.wait(LIMIT_S) == 0
    ground.wait(lambda g: not g.tokens and g.statuses["real_1"].state == "POWEROFF")


def certificates(folder: Path) -> None:
    """A CA, a router's certificate for 127.0.0.1 and an agent's; another CA that is not trusted."""
    for name in ("ca", "other"):
        openssl(
            "req", "-x509", *NEW, "-keyout", f"{name}.key", "-out", f"{name}.pem", "-subj", f"/CN={name}", folder=folder
        )
    for name in ("router", "agent"):
        openssl("req", *NEW, "-keyout", f"{name}.key", "-out", f"{name}.csr", "-subj", f"/CN={name}", folder=folder)
        (folder / f"{name}.ext").write_text("subjectAltName=IP:127.0.0.1\n")
        words = ("-in", f"{name}.csr", "-CA", "ca.pem", "-CAkey", "ca.key", "-CAcreateserial", "-days", "2")
        openssl("x509", "-req", *words, "-extfile", f"{name}.ext", "-out", f"{name}.pem", folder=folder)


NEW = ("-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes", "-days", "2")


def openssl(*words: str, folder: Path) -> None:
    if words[0] == "req" and "-x509" not in words:
        words = tuple(word for word in words if word not in ("-days", "2"))
    subprocess.run(("openssl", *words), cwd=folder, check=True, capture_output=True, timeout=60)


ASKED = ("declare_subscriber", "query")
SAID = (
    "put",
    "delete",
    "declare_queryable",
    "reply",
    "liveliness_token",
    "liveliness_query",
    "declare_liveliness_subscriber",
)


def rule(name: str, keys: str, messages: Sequence[str], *flows: str) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": flows, "messages": messages, "key_exprs": [keys]}


def test_tls_restricts_a_fleet(bench: Bench, tmp_path: Path) -> None:
    """A client without a certificate, or of another CA, is not admitted; one with a certificate may write only below
    its own key.
    """
    certificates(tmp_path)
    place = "transport__link__tls__"
    files = {"root_ca_certificate": "ca.pem", "listen_certificate": "router.pem", "listen_private_key": "router.key"}
    options = {f"{place}{name}": str(tmp_path / file) for name, file in files.items()}
    access = {
        "enabled": True,
        "default_permission": "deny",
        "rules": [
            rule("own", f"phm/{FLEET}/good/**", SAID, "ingress", "egress"),
            rule("asked", f"phm/{FLEET}/**", ASKED, "egress"),
            rule("all", "phm/**", SAID + ASKED, "ingress", "egress"),
        ],
        "subjects": [{"id": "agent", "cert_common_names": ["agent"]}, {"id": "ground", "link_protocols": ["tcp"]}],
        "policies": [{"rules": ["own", "asked"], "subjects": ["agent"]}, {"rules": ["all"], "subjects": ["ground"]}],
    }
    secret = f"tls/127.0.0.1:{free_port()}"
    listen = [secret, bench.endpoint]
    bench.router(listen__endpoints=listen, access_control=access, **options, **{f"{place}enable_mtls": True})

    def tls(name: str, **files: str) -> Agent:
        chosen = {key: str(tmp_path / file) for key, file in files.items()}
        return bench.agent(name, endpoint=secret, tls=chosen)

    good = tls("good", ca="ca.pem", certificate="agent.pem", key="agent.key")
    impostor = tls("impostor", ca="ca.pem", certificate="agent.pem", key="agent.key")
    anonymous = tls("anonymous", ca="ca.pem")
    misled = tls("misled", ca="other.pem", certificate="agent.pem", key="agent.key")
    missing = tls("missing", ca="none.pem")
    ground = bench.ground()
    ground.wait(lambda g: "good" in g.statuses and bool(g.tokens))
    for agent in (anonymous, misled, missing):
        until(agent.reporter.problem, "a problem to be reported")
    until(lambda: impostor.reporter.report()["published"], "the publication by the impostor")
    good.tick()
    ground.wait(lambda g: g.statuses["good"].open_faults == 1)
    late = bench.ground()
    late.wait(lambda g: "good" in g.statuses and bool(g.tokens))
    for reader in (ground, late):
        assert set(reader.statuses) == {"good"}
        assert {name for name, _ in list(reader.tokens)} <= {"good"}


def put_until_refused(stranger: Any, ground: Ground, payload: bytes) -> None:
    """Zenoh drops publications made before the router knows the reader's subscription, so one put may not arrive."""
    before = ground.refused

    def refused() -> bool:
        stranger.put(f"phm/{FLEET}/agent_1/status", payload)
        return ground.refused > before

    until(refused, "a refused message")


def test_a_stranger_cannot_crash_a_reader_or_an_agent(bench: Bench) -> None:
    """Any publication under the keys of the fleet is rejected or accepted, and everything else continues."""
    bench.router()
    agent, ground = bench.agent(), bench.ground()
    stranger = zenoh.open(config("client", connect__endpoints=[bench.endpoint]))
    bench.later(stranger.close)
    for payload in (b"", b"{", b"[" * 60_000, b"\xff\xfe", b'{"v":1}'):
        put_until_refused(stranger, ground, payload)
    token = stranger.liveliness().declare_token(f"phm/{FLEET}/agent_1/alive/x")
    ground.wait(lambda g: len(g.tokens) == 2)
    token.undeclare()  # type: ignore[no-untyped-call]
    agent.tick()
    # The agent may have published its first status before the router knew of this reader.
    ground.wait(lambda g: "agent_1" in g.statuses and g.statuses["agent_1"].open_faults == 1)
