"""Alerts to a real HTTP server and a real command."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from email import message_from_bytes
from email.policy import default
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socketserver import StreamRequestHandler, ThreadingTCPServer
from typing import Any, ClassVar

import pytest

from phm.api import Unit
from phm.checking.pipeline import Pipeline
from phm.core import process_group
from phm.core.bus import Bus
from phm.core.model import (
    ActionEvent,
    Event,
    Fault,
    FaultClosed,
    FaultOpened,
    Layer,
    Level,
    Outcome,
    Phase,
    Result,
    Slot,
    Stamp,
)
from phm.reporters import notify
from phm.reporters.base import ReporterContext
from phm.reporters.notify import NotifyReporter
from phm.runtime.sections import reporter_settings
from phm.testing import FakeClock, settings
from phm.tracker import Tracker
from phm.tracker.units import TrackedUnit, graph_of
from tests.fakes.until import until

# Of the plug-ins of Apprise, which it imports when they are first used.
pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

AT = Stamp(1.8e9, 10.0)
FOUND = Result(Level.ERROR, "ros_app exited with code 1", "ros_app exited 1", "exited", "ros_app")
FAULT = Fault("ab12-17", "container/ros_app", Slot.CONTAINER, Layer.DOCKER, FOUND, AT)


class Hook:
    """A web server that keeps what is posted to it."""

    def __init__(self) -> None:
        self.posted: list[dict[str, Any]] = []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_POST(self) -> None:
                body = self.rfile.read(int(self.headers["Content-Length"]))
                outer.posted.append(json.loads(body))
                self.send_response(200)
                self.end_headers()

            def log_message(self, *_: object) -> None: ...

        self.server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        threading.Thread(target=self.server.serve_forever, daemon=True).start()
        # Apprise waits 4 s for a connection or an answer, unless its URL says otherwise.
        self.url = f"json://127.0.0.1:{self.server.server_address[1]}/phm?cto=60&rto=60"


@pytest.fixture(autouse=True)
def long_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """A command that a busy machine starts late is not killed."""
    monkeypatch.setattr(notify, "COMMAND_S", 60.0)


@pytest.fixture
def hook() -> Iterator[Hook]:
    made = Hook()
    yield made
    made.server.shutdown()
    made.server.server_close()


def make(clock: FakeClock | None = None, **notify_settings: Any) -> NotifyReporter:
    made = settings(agent={"id": 5, "name": "agent_5"}, notify=notify_settings)
    context = ReporterContext(reporter_settings(made), clock or FakeClock(), "b", tuple, lambda: True, dict)
    reporter = NotifyReporter.build(context)
    assert reporter is not None
    return reporter


def steps() -> list[Event]:
    """A fault opens and PHM gives up on it, which closes it; two others follow from another one, and are resolved."""

    def closed(name: str, outcome: Outcome) -> FaultClosed:
        return FaultClosed(AT, replace(FAULT, id=name, outcome=outcome, closed=AT))

    return [
        FaultOpened(AT, FAULT),
        ActionEvent(AT, FAULT.id, FAULT.unit, "restart", "ros_app", Phase.STARTED),
        ActionEvent(AT, FAULT.id, FAULT.unit, "restart", "ros_app", Phase.ESCALATED, "three restarts did not help"),
        closed(FAULT.id, Outcome.ESCALATED),
        closed("ab12-18", Outcome.REATTRIBUTED),
        closed("ab12-19", Outcome.RESOLVED),
    ]


def test_a_webhook_gets_open_escalation_and_close(hook: Hook) -> None:
    """By Apprise, as JSON; steps in between are not alerts."""
    reporter = make(urls=[hook.url])
    for event in steps():
        reporter.handle(event)
    until(lambda: len(hook.posted) == 4, "the alerts")
    reporter.close()
    assert [post["title"] for post in hook.posted] == [
        "A05 FAIL 2 ros_app exited 1",
        "A05 GAVE UP 2 ros_app exited 1",
        "A05 REATTRIBUTED 2 ros_app exited 1",
        "A05 RESOLVED 2 ros_app exited 1",
    ]
    assert [post["type"] for post in hook.posted] == ["failure", "failure", "info", "success"]
    assert "three restarts did not help" in hook.posted[1]["message"]
    assert reporter.problem() == ""


def test_an_alert_is_sent_when_phm_gives_up_whatever_the_threads_do() -> None:
    """Recovery reports it and closes the fault immediately: when this thread gets the event, the fault is not open."""
    clock, bus = FakeClock(), Bus(FakeClock())
    units = [TrackedUnit(Unit(FAULT.unit, target="ros_app"), "container", Slot.CONTAINER, Layer.DOCKER)]
    pipeline = Pipeline(Tracker(units, graph_of(units), clock.stamp()), bus, clock)
    reporter, sent = make(command=["true"], events=["escalate"]), list[str]()
    reporter._senders = (lambda alert: sent.append(alert["title"]) or "",)  # type: ignore[assignment,func-returns-value]
    bus.subscribe("notify", reporter.handle, kinds=reporter.kinds)
    pipeline.observe({FAULT.unit: FOUND}, clock.mono(), 0.0)
    (fault,) = pipeline.open_faults()
    bus.publish(ActionEvent(AT, fault.id, fault.unit, "", "ros_app", Phase.ESCALATED, "it did not help"))
    pipeline.escalate(fault.id)
    until(lambda: sent == ["A05 GAVE UP 2 ros_app exited 1"], "the alert")
    reporter.close()
    bus.close(1.0)


def test_a_command_gets_the_alert_as_json(tmp_path: Path) -> None:
    """Started without a shell, so that no name from outside is interpreted."""
    output = tmp_path / "alert; touch hacked"
    script = "import sys; open(sys.argv[1], 'ab').write(sys.stdin.buffer.read() + b'\\n')"
    reporter = make(command=[sys.executable, "-c", script, str(output)], events=["escalate"])
    for event in steps():
        reporter.handle(event)
    until(lambda: output.exists() and output.read_bytes().endswith(b"\n"), "the alert")
    reporter.close()
    (alert,) = map(json.loads, output.read_bytes().splitlines())
    assert (alert["event"], alert["agent_id"], alert["fault"]["fault"]) == ("escalate", 5, "ab12-17")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == [output.name]


@pytest.mark.parametrize(
    ("chosen", "words"),
    [
        ({"command": ["/no/such/program"]}, "/no/such/program cannot be started: No such file or directory"),
        ({"command": [sys.executable, "-c", "raise SystemExit(3)"]}, "ended with exit code 3"),
        ({"urls": ["json://127.0.0.1:1/"]}, "could not be sent to all of notify.urls"),
        ({"urls": ["nothing://x"]}, "notify.urls[0] is not a URL that Apprise knows"),
    ],
)
def test_an_alert_that_cannot_be_sent_is_a_problem_without_secrets(chosen: dict[str, Any], words: str) -> None:
    """Shown in `phm status`; it ends with the next alert that is sent."""
    reporter = make(**chosen)
    reporter.handle(FaultOpened(AT, FAULT))
    until(reporter.problem, "the problem")
    assert words in reporter.problem()
    reporter.close()


class Mailbox(StreamRequestHandler):
    """One SMTP dialogue; the mail is appended to `mails`."""

    mails: ClassVar[list[bytes]] = []

    def handle(self) -> None:
        self.wfile.write(b"220 mailbox\r\n")
        while word := self.rfile.readline()[:4].upper():
            if word == b"DATA":
                self.wfile.write(b"354 go on\r\n")
                self.mails.append(b"".join(iter(self.rfile.readline, b".\r\n")))
            self.wfile.write(b"221 bye\r\n" if word == b"QUIT" else b"250 mailbox\r\n")


def test_an_email_shows_text_from_outside_as_it_is() -> None:
    """A health check's output is not HTML: it makes no link, and what is between angle brackets is not lost."""
    with ThreadingTCPServer(("127.0.0.1", 0), Mailbox) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        url = f"mailto://127.0.0.1:{server.server_address[1]}?from=a@example.org&to=b@example.org&mode=insecure"
        body = "container/app: <a href='http://example.org/'>log in</a>"
        assert notify.send_to_urls({"title": "A01 FAIL", "body": body, "type": "failure"}, [url]) == ""
        server.shutdown()
    (mail,) = Mailbox.mails
    parts = {
        part.get_content_type(): part.get_content()
        for part in message_from_bytes(mail, policy=default).walk()
        if not part.is_multipart()
    }
    assert "<a href" not in parts.get("text/html", "")
    assert "log in" in "".join(parts.values()) and "<a href='http://example.org/'>" in parts.get("text/plain", body)


def test_a_command_that_hangs_is_killed_with_its_children(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A later alert tries again."""
    pids = tmp_path / "pids"
    code = f"import os, signal; os.fork(); open({str(pids)!r}, 'a').write(f'{{os.getpid()}}\\n'); signal.pause()"
    command = notify.AlertCommand([sys.executable, "-c", code])
    for limit_s in (2.0, 8.0, 32.0):  # a busy machine may need seconds to start Python
        monkeypatch.setattr(notify, "COMMAND_S", limit_s)
        assert command({}) == f"{sys.executable} did not end within {limit_s:g} s and was killed"
        if pids.exists() and len(pids.read_text().split()) >= 2:
            break
    until(lambda: not any(runs(int(pid)) for pid in pids.read_text().split()), "the end of the command and its child")


def test_a_command_that_cannot_be_killed_is_not_started_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing waits for it, as for one that hangs in the kernel."""
    command = notify.AlertCommand(["/bin/sleep", "600"])
    monkeypatch.setattr(notify, "COMMAND_S", 0.1)
    monkeypatch.setattr(process_group, "kill", lambda group: None)
    monkeypatch.setattr(process_group, "REAP_S", 0.1)
    assert "did not end within 0.1 s" in command({})
    assert command({}) == "/bin/sleep of an earlier alert was killed and has not ended"
    hung = command._hung
    assert hung is not None
    hung.kill()
    until(lambda: hung.poll() is not None, "its end")


def test_what_a_slow_command_leaves_out_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """The oldest alerts that wait are dropped."""
    monkeypatch.setattr(notify, "MAX_WAITING", 2)
    began, go, sent = threading.Event(), threading.Event(), list[int]()

    def send(alert: dict[str, Any]) -> str:
        began.set()
        go.wait()
        sent.append(alert["left_out"])
        return ""

    made = settings(notify={"command": ["x"], "per_minute": 60})
    reporter = NotifyReporter(
        ReporterContext(reporter_settings(made), FakeClock(), "b", tuple, lambda: True, dict), [send]
    )
    reporter.handle(FaultOpened(AT, FAULT))
    assert began.wait(60.0)
    for _ in range(5):
        reporter.handle(FaultOpened(AT, FAULT))
    go.set()
    until(lambda: len(sent) == 3, "the alerts")
    assert sent == [0, 3, 0]
    reporter.close()


def test_a_missing_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is an extra, and imported only for an alert."""
    monkeypatch.setitem(sys.modules, "apprise", None)
    assert notify.send_to_urls({}, ["json://x"]) == notify.MISSING
    assert "install the extra 'notify' (in a clone of PHM: pip install '.[notify]')" in notify.MISSING


def runs(pid: int) -> bool:
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False


def test_alerts_are_limited_and_what_was_left_out_is_counted() -> None:
    """A flapping container sends no hundred messages to a telephone."""
    clock, sent = FakeClock(), list[dict[str, Any]]()
    made = settings(notify={"command": ["x"], "per_minute": 2})
    reporter = NotifyReporter(
        ReporterContext(reporter_settings(made), clock, "b", tuple, lambda: True, dict),
        [lambda alert: sent.append(alert) or ""],
    )
    for _ in range(5):
        reporter.handle(FaultOpened(AT, FAULT))
    clock.advance(30.0)
    reporter.handle(FaultOpened(AT, FAULT))
    until(lambda: len(sent) == 3, "the alerts")
    assert [alert["left_out"] for alert in sent] == [0, 0, 3]
    assert "3 alerts before this one were left out" in sent[-1]["body"]
    reporter.close()


def test_a_slow_service_delays_nothing_else() -> None:
    """Neither PHM's other reports nor its end; alerts that wait are limited in number."""
    held, begun = threading.Event(), threading.Event()

    def slow(alert: dict[str, Any]) -> str:
        begun.set()
        held.wait(120)
        return ""

    made = settings(notify={"command": ["x"], "per_minute": 600})
    reporter = NotifyReporter(
        ReporterContext(reporter_settings(made), FakeClock(), "b", tuple, lambda: True, dict), [slow]
    )
    for _ in range(500):
        reporter.handle(FaultOpened(AT, FAULT))
    until(begun.is_set, "the first alert")
    reporter.close()
    assert len(reporter._queue) <= notify.MAX_WAITING
    held.set()


def test_notifications_are_off_by_default() -> None:
    """Without urls and command there is no reporter."""
    context = ReporterContext(reporter_settings(settings()), FakeClock(), "b", tuple, lambda: True, dict)
    assert NotifyReporter.build(context) is None
