"""A real `phm gcs --web`, a fleet that sends real frames to it over UDP, and a headless Chromium that shows the page."""

from __future__ import annotations

import contextlib
import http.client
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import psutil
from playwright.sync_api import Browser, BrowserContext, Error, Page, sync_playwright

from phm.core.model import Level, Slot
from phm.transport.dialect import mavlink
from phm.wire import tunnel
from phm.wire.tunnel import PeerState, PeerView, SwarmDigest
from tests.fakes.mavlink import free_port
from tests.fakes.until import until
from tests.gcs.web.swarm import Vehicle

ROOT = Path(__file__).parents[4]
LIMIT_MS = 120_000
CHROMIUM = "/usr/bin/chromium"
SWITCHES = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
    "--renderer-process-limit=1",  # else two spare processes start with each tab
)  # fmt: skip
COMPLETE = "document.readyState === 'complete' && sessionStorage.getItem('phm-loads') === null"
"""No file of the page is missing (phm/gcs/web/static/js/boot.js)."""
LONG_LIMITS = """
from phm.cli import main
from phm.gcs import operator
operator.RESEND_S, operator.REPLY_S = 15.0, 5.0  # on a busy machine an answer takes a while
main()
"""
SYSTEMS = 250
ERROR, WARN, STALE = Level.ERROR, Level.WARN, Level.STALE
Levels = Mapping[Slot, Level]


class GroundProcess:
    """`phm gcs --web` as an operator starts it; can be killed and started again at the same address."""

    def __init__(self, folder: Path, *options: str) -> None:
        self.mavlink, self.port = free_port(socket.SOCK_DGRAM), free_port()
        self._folder, self._options = folder, options
        self._log = (folder / "gcs.log").open("ab")
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/"

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    def start(self) -> None:
        """Returns when the page is served and MAVLink is received: a line that is sent once must arrive."""
        words = [sys.executable, "-c", LONG_LIMITS, "gcs", "--web", f"127.0.0.1:{self.port}"]
        if "--replay" not in self._options:
            words += [f"udpin:127.0.0.1:{self.mavlink}", "--history", str(self._folder / "history.db")]
        self._process = subprocess.Popen(
            [*words, *self._options], cwd=ROOT, stdin=subprocess.DEVNULL, stdout=self._log, stderr=self._log,
            env={**os.environ, "PYTHONPATH": f"{ROOT}:{ROOT / 'checks'}", "HOME": str(self._folder)},
        )  # fmt: skip
        until(self._serves, "the page", lambda: (self._folder / "gcs.log").read_text()[-2000:])
        if "--replay" not in self._options:
            bound = f":{self.mavlink:04X} "
            until(lambda: bound in Path("/proc/net/udp").read_text("ascii"), "the endpoint")

    def _serves(self) -> bool:
        assert self._process is not None
        assert self._process.poll() is None, (self._folder / "gcs.log").read_text()
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=5)
        with contextlib.closing(connection), contextlib.suppress(OSError):
            connection.request("GET", "/")
            return connection.getresponse().status == 200
        return False

    def kill(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait(120)
            self._process = None

    def close(self) -> None:
        self.kill()
        self._log.close()


class Fleet:
    """Agents that send a heartbeat each second from one thread, spread over it. Changed by the test at any time."""

    def __init__(self, port: int, numbers: range | list[int], period_s: float = 1.0) -> None:
        self.vehicles = {number: _vehicle(number, port) for number in numbers}
        self.levels: dict[int, Levels] = {}
        self.armed: dict[int, bool] = {}
        self.silent: set[int] = set()
        self.views: dict[int, PeerView] = {}
        self.digest: SwarmDigest | None = None
        self._period_s = period_s
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._loop, name="test-fleet", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join(60)
        for vehicle in self.vehicles.values():
            vehicle.close()

    def _loop(self) -> None:
        pause_s = self._period_s / max(1, len(self.vehicles))
        due_s = time.monotonic()
        while True:
            for number, vehicle in self.vehicles.items():
                due_s += pause_s
                if self._stop.wait(max(0.0, due_s - time.monotonic())):
                    return
                if number not in self.silent:
                    levels = self.levels.get(number, {})
                    vehicle.heartbeat(levels, 6 if ERROR in levels.values() else 4)
                    if number in self.armed:
                        vehicle.autopilot(armed=self.armed[number])
                    if number in self.views:
                        self.send_tunnel(number, self.views[number])
                    if number == 1 and self.digest is not None:
                        self.send_tunnel(number, self.digest)

    def say(self, number: int, words: str, severity: int = 2) -> None:
        self.vehicles[number].say(words, severity)

    def send_tunnel(self, number: int, message: tunnel.TunnelMessage) -> None:
        payload = tunnel.encode(message)
        padded = payload.ljust(128, b"\0")
        self.vehicles[number].send(mavlink.MAVLink_tunnel_message(0, 0, tunnel.PAYLOAD_TYPE, len(payload), padded))


def _vehicle(number: int, port: int) -> Vehicle:
    """MAVLink has ids for 250 systems: more agents share them, and differ in the component, as A01/194."""
    return Vehicle((number - 1) % SYSTEMS + 1, port, 193 + (number - 1) // SYSTEMS)


def a_bad_day(fleet: Fleet) -> None:
    """Faults of several kinds, as a swarm reports them."""
    fleet.levels.update({
        2: {Slot.NODES: ERROR, Slot.TOPICS: ERROR}, 5: {Slot.HOST: WARN}, 7: {Slot.CONTAINER: ERROR, Slot.NODES: STALE, Slot.TOPICS: STALE},
        9: {Slot.RATES: WARN, Slot.RADIO: WARN},
    })  # fmt: skip
    for number in fleet.vehicles:
        fleet.armed[number] = number % 3 != 0
    fleet.say(2, "A02 FAIL 11111001 6 planner dead")
    fleet.say(5, "A05 WARN 9 disk / 91%", 4)
    fleet.say(7, "A07 FAIL 10111--1 2 ros_app exited (137)")
    fleet.say(7, "A07 ADVISE 2 restart ros_app #17 60s", 4)
    fleet.say(9, "A09 WARN 8 /camera 4.1 Hz, want 10", 4)
    everyone = list(fleet.vehicles)
    for number in everyone:
        fleet.views[number] = PeerView(
            1, True, True, True, {peer: PeerState.ALIVE for peer in everyone if peer != number}
        )
    levels = dict.fromkeys(everyone, Level.OK) | {2: ERROR, 5: WARN, 7: ERROR}
    fleet.digest = SwarmDigest(len(everyone), len(everyone), levels)


@contextlib.contextmanager
def chromium() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=list(SWITCHES))
        try:
            yield browser
        finally:
            browser.close()


@contextlib.contextmanager
def tab(browser: Browser, url: str, **options: Any) -> Iterator[Page]:
    """A page that fails the test at its end when a script failed or the content security policy blocked something."""
    context = browser.new_context(viewport=options.pop("viewport", {"width": 1366, "height": 900}), **options)
    context.set_default_timeout(LIMIT_MS)
    page = context.new_page()
    problems: list[str] = []
    page.on("pageerror", lambda error: problems.append(str(error)))
    page.on("console", lambda said: problems.append(said.text) if "Content Security Policy" in said.text else None)
    page.goto(url)
    if url.startswith("http"):
        until(lambda: _complete(page), "the page with all of its files", step=lambda: page.wait_for_timeout(50))
    try:
        yield page
        assert not problems
    finally:
        failed = sys.exc_info()[0] is not None
        try:
            _close(context)
        except Error:
            if not failed:  # else it would hide why the test failed
                raise


def _complete(page: Page) -> bool:
    """Whether no file is missing: beside tests of Docker a browser ends requests (ERR_NETWORK_CHANGED), and the page loads itself again."""
    try:
        return bool(page.evaluate(COMPLETE))
    except Error:  # it is loading itself again
        return False


def _close(context: BrowserContext) -> None:
    """`close` has no time limit: a Chromium that hangs (seen once) is killed, so that the tests end."""
    guard = threading.Timer(LIMIT_MS / 1000, _kill_chromium)
    guard.start()
    try:
        context.close()
    finally:
        guard.cancel()


def _kill_chromium() -> None:
    """Kill each Chromium that this process has started."""
    for process in psutil.Process().children(recursive=True):
        with contextlib.suppress(psutil.Error):
            if process.name().startswith("chrom"):
                process.kill()


@contextlib.contextmanager
def ground(folder: Path, *options: str) -> Iterator[GroundProcess]:
    made = GroundProcess(folder, *options)
    try:
        made.start()
        yield made
    finally:
        made.close()


@contextlib.contextmanager
def fleet(port: int, numbers: range | list[int], period_s: float = 1.0) -> Iterator[Fleet]:
    made = Fleet(port, numbers, period_s)
    made.start()
    try:
        yield made
    finally:
        made.close()
