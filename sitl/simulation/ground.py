"""A simulated ground station: the lines of PHM that an operator would see, on a terminal or as JSON.

``python -m sitl.simulation.ground tcp:127.0.0.1:5760 [--json] [--for SECONDS]``
"""

from __future__ import annotations

import argparse
import contextlib
import json
import select
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from phm.core.model import Level, Slot
from phm.simulation.mavlink_port import Port, mavlink
from phm.wire import status_word

SYSTEM, COMPONENT = 255, 190
HEARTBEAT_S = 1.0
RETRY_S = 0.3
KEPT = 10_000
MAX_SENDERS = 512
_SEVERITIES = ("EMERGENCY", "ALERT", "CRITICAL", "ERROR", "WARNING", "NOTICE", "INFO", "DEBUG")
_STATES = ("UNINIT", "BOOT", "CALIBRATING", "STANDBY", "ACTIVE", "CRITICAL", "EMERGENCY", "POWEROFF", "TERMINATED")


@dataclass(frozen=True, slots=True)
class TextLine:
    """One STATUSTEXT. Times of this machine in seconds: `utc` since the epoch, `mono` monotonic."""

    utc: float
    mono: float
    system: int
    component: int
    severity: int
    text: str


@dataclass(frozen=True, slots=True)
class WordChange:
    """A HEARTBEAT whose status word or system_status differs from the sender's last."""

    utc: float
    mono: float
    system: int
    component: int
    word: int
    system_status: int

    @property
    def levels(self) -> dict[Slot, Level]:
        return status_word.decode(self.word)


class Ground:
    """Connects like a ground station, keeps reconnecting, and stores what it received (the last KEPT of each).

    `lines` and `words` are filled by a thread between `start` and `stop`; that thread calls `on_news` with each, and
    `on_frame` with every message and its time of arrival, in seconds of the monotonic clock.
    """

    def __init__(
        self,
        url: str,
        on_news: Callable[[TextLine | WordChange], None] | None = None,
        system: int = SYSTEM,
        *,
        on_frame: Callable[[float, Any], None] | None = None,
    ) -> None:
        self.url = url
        self.lines: deque[TextLine] = deque(maxlen=KEPT)
        self.words: deque[WordChange] = deque(maxlen=KEPT)
        self.heartbeats: dict[tuple[int, int], float] = {}
        """Monotonic time of the last HEARTBEAT by (system, component)."""
        self._on_news = on_news
        self._on_frame = on_frame
        self._mav = mavlink.MAVLink(None, srcSystem=system, srcComponent=COMPONENT)
        self._last: dict[tuple[int, int], tuple[int, int]] = {}
        self._stopping = threading.Event()
        self._port: Port | None = None
        self._thread = threading.Thread(target=self._loop, name="ground", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._stopping.set()
        self._thread.join(3.0)

    def wait(self, wanted: Callable[[Ground], bool], limit_s: float) -> bool:
        """Wait until `wanted` is true for this ground station; False after `limit_s`."""
        end = time.monotonic() + limit_s
        while not wanted(self):
            if time.monotonic() > end:
                return False
            self._stopping.wait(0.02)
        return True

    def arm(self, system: int, *, armed: bool) -> None:
        """Command a vehicle's autopilot to arm or disarm."""
        command = mavlink.MAVLink_command_long_message(
            system, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, float(armed), 0, 0, 0, 0, 0, 0
        )
        self._send(command)

    def _loop(self) -> None:
        while not self._stopping.is_set():
            try:
                self._port = Port(self.url)
            except OSError:
                self._stopping.wait(RETRY_S)
                continue
            try:
                self._listen(self._port)
            finally:
                self._port.close()

    def _listen(self, port: Port) -> None:
        due = 0.0
        while not self._stopping.is_set() and not port.lost:
            if time.monotonic() >= due:
                due = time.monotonic() + HEARTBEAT_S
                self._send(mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3))
            try:
                readable, _, _ = select.select(port.sockets(), [], [], 0.05)
            except (OSError, ValueError):
                return  # another thread has closed the port: its number is -1
            for sock in readable:
                for _, message in port.receive(sock):
                    self._take(message)

    def _send(self, message: Any) -> None:
        port = self._port
        if port is not None:
            with contextlib.suppress(OSError):
                port.send(message.pack(self._mav))
            self._mav.seq = (self._mav.seq + 1) % 256

    def _take(self, message: Any) -> None:
        sender = (message.get_srcSystem(), message.get_srcComponent())
        now = (time.time(), time.monotonic())
        if self._on_frame is not None:
            self._on_frame(now[1], message)
        if message.get_type() == "STATUSTEXT":
            line = TextLine(*now, *sender, message.severity, message.text)
            self.lines.append(line)
            self._publish(line)
        elif message.get_type() == "HEARTBEAT" and (sender in self._last or len(self._last) < MAX_SENDERS):
            self.heartbeats[sender] = now[1]
            seen = (message.custom_mode, message.system_status)
            if message.type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER and self._last.get(sender) != seen:
                self._last[sender] = seen
                change = WordChange(*now, *sender, *seen)
                self.words.append(change)
                self._publish(change)

    def _publish(self, news: TextLine | WordChange) -> None:
        if self._on_news is not None:
            self._on_news(news)


def as_text(news: TextLine | WordChange) -> str:
    """One line for an operator: time, sender, severity or state, and the text or the slots that are not OK."""
    clock = time.strftime("%H:%M:%S", time.localtime(news.utc)) + f".{int(news.utc % 1 * 1000):03d}"
    head = f"{clock} {news.system}/{news.component}"
    if isinstance(news, TextLine):
        name = _SEVERITIES[news.severity] if news.severity < len(_SEVERITIES) else str(news.severity)
        # The text is from a radio link: it must not be able to control this terminal.
        return f"{head} {name:8} {''.join(char if char.isprintable() else '?' for char in news.text)}"
    state = _STATES[news.system_status] if news.system_status < len(_STATES) else str(news.system_status)
    try:
        levels = " ".join(f"{slot:d}:{level.name}" for slot, level in news.levels.items())
    except ValueError as error:
        levels = str(error)
    return f"{head} {state:8} word 0x{news.word:08X} {levels or 'nothing known'}"


def main(arguments: list[str] | None = None) -> int:
    words = argparse.ArgumentParser(prog="python -m sitl.simulation.ground", description=__doc__.partition("\n")[0])
    words.add_argument("url", help="tcp:HOST:PORT, udpin:HOST:PORT or udpout:HOST:PORT")
    words.add_argument("--json", action="store_true", help="one JSON object a line")
    words.add_argument("--for", dest="seconds", type=float, default=None, metavar="SECONDS", help="end after this time")
    chosen = words.parse_args(arguments)

    def show(news: TextLine | WordChange) -> None:
        kind = "text" if isinstance(news, TextLine) else "word"
        print(json.dumps({"kind": kind, **asdict(news)}) if chosen.json else as_text(news), flush=True)

    ground = Ground(chosen.url, show)
    ground.start()
    with contextlib.suppress(KeyboardInterrupt):
        threading.Event().wait(chosen.seconds)
    ground.stop()
    return 0


if __name__ == "__main__":
    sys.exit(main())
