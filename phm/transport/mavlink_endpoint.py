"""One MAVLink endpoint: a thread that opens it, keeps it open, and moves messages both ways."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Set
from typing import Any

from phm.core import polling, threads
from phm.core.backoff import Backoff
from phm.core.clock import Clock
from phm.core.settings import EndpointSettings
from phm.facts import LinkFact
from phm.transport.dialect import mavlink
from phm.transport.mavlink_channels import Channel
from phm.transport.mavlink_codec import Codec
from phm.transport.mavlink_connection import ChannelOpener
from phm.transport.mavlink_traffic import Traffic
from phm.transport.priority import MessageCount, MessagePriority
from phm.transport.send_queue import HEARTBEAT, SendQueue
from phm.transport.serial_errors import SerialErrorCount

logger = logging.getLogger(__name__)

RADIO_STATUS = 109
BACKOFF_S = 0.1
BACKOFF_MAX_S = 5.0
STEADY_S = 5.0
"""An endpoint that was open for this long resets its back-off."""
SILENT_S = 10.0
"""The name of a peer is resolved again after this silence."""
IDLE_S = 0.5
FAREWELL_S = 0.3
REPEATS, REPEAT_S = 2, 0.1
"""How often a HEARTBEAT with POWEROFF is repeated within FAREWELL_S, and after what time."""
REOPEN_POLL_S = 0.05


class Endpoint:
    """See the module.

    `deliver` gets every message that a listener wants. `changed` is called when the endpoint opens or closes, and about
    every IDLE_S meanwhile (every back-off while it is closed). `sent` gets each message that was sent, with its frame. All are
    called in the endpoint's thread.
    """

    def __init__(
        self,
        settings: EndpointSettings,
        codec: Codec,
        clock: Clock,
        deliver: Callable[[Any, str], None],
        changed: Callable[[], None],
        sent: Callable[[Any, bytes], None] = lambda message, frame: None,
        dev_root: str = "/dev",
    ) -> None:
        self.name, self.container = settings.key, settings.container
        self.to_peers, self._radio = settings.leads_to == "peers", settings.radio != "off"
        self.codec = codec
        self._clock, self._deliver, self._changed, self._sent = clock, deliver, changed, sent
        self._queue = SendQueue(clock, settings.budget or None)
        self._stopping = threading.Event()
        self._soon = threading.Event()
        """Ends every wait while it is closed; also set with `_stopping`."""
        self._opener = ChannelOpener(settings, codec, clock, self._soon, dev_root)
        self._bell = polling.Bell()
        self._fact: LinkFact | None = None
        self._line: SerialErrorCount | None = None
        self._again = threading.Event()
        self._opened = 0
        self._received = self._polled = 0.0
        self._read_at: float | None = None
        self._last_heartbeat: Any = None
        self._thread = threading.Thread(target=self._loop, name=f"phm-mavlink-{self.name}"[:60], daemon=True)

    def start(self) -> None:
        threads.start(self._thread)

    def send(
        self,
        message: Any,
        kind: MessagePriority,
        key: str,
        urgency: int,
        only_while: tuple[str, ...] = (),
        *,
        only_replace: bool = False,
    ) -> None:
        """Queue a message; never blocks."""
        self._queue.put(message, self.codec.size(message), kind, key, urgency, only_while, only_replace=only_replace)
        self._ring()

    def set_true(self, names: Set[str]) -> None:
        """What is true now: messages may wait for it."""
        self._queue.set_true(names)
        if self._queue:
            self._ring()

    def set_agent_count(self, agents: int, *, leads: bool) -> None:
        """Set how many agents share the link, and whether this one is the leader of the swarm."""
        self._queue.set_agent_count(agents, leads=leads)

    def budget(self) -> tuple[dict[MessagePriority, MessageCount], float]:
        """Messages sent, replaced or dropped, by priority; and the current slow-down by the radio."""
        return self._queue.counts, self._queue.slowed()

    def fact(self) -> LinkFact | None:
        """Whether it is open; None until the first attempt to open has ended."""
        return self._fact

    def read_at(self) -> float | None:
        """When the thread last had read all received data; None: not open."""
        return self._read_at

    def traffic(self) -> Traffic:
        """Bytes and frames since the endpoint was created, and what was received from each sender."""
        counters = self.codec.counters
        return Traffic(
            counters.bytes_in,
            counters.bytes_out,
            counters.received,
            counters.bad,
            self.codec.senders.now(),
            self._line,
            counters.frame_bytes,
            counters.verified,
        )

    def reopen(self, timeout_s: float) -> bool:
        """Let the thread close and reopen the channel. Returns whether it was open again within `timeout_s`."""
        before, end = self._opened, self._clock.mono() + timeout_s
        self._again.set()
        self._ring()
        while self._opened == before and self._clock.mono() < end and not self._stopping.is_set():
            self._clock.wait(self._stopping, REOPEN_POLL_S)
        return self._opened != before

    def retry_now(self) -> None:
        """The container at the other end started: try immediately, and again soon. No effect while the endpoint is
        open."""
        if self._fact is None or not self._fact.open:
            self._soon.set()

    def stop(self) -> None:
        """Ask the thread to send what is queued, for at most FAREWELL_S, and to end."""
        self._stopping.set()
        self._soon.set()
        self._ring()

    def join(self, timeout_s: float) -> bool:
        """Whether its thread has ended, so that nothing more is sent."""
        threads.join(self._thread, timeout_s)
        return not self._thread.is_alive()

    # ------------------------------------------------------------ the thread

    def _loop(self) -> None:
        backoff = Backoff(BACKOFF_S, BACKOFF_MAX_S)
        while not self._stopping.is_set():
            was_open, opened = False, 0.0
            try:
                channel = self._opener.open()
                was_open, opened = True, self._clock.mono()
                self._live(channel)
            except OSError as error:
                self._set_state(is_open=False, error=error.strerror or str(error), code=error.errno or 0)
            except Exception as error:  # a defect must not end this link permanently
                logger.exception("MAVLink endpoint %s failed unexpectedly", self.name)
                self._set_state(is_open=False, error=f"{type(error).__name__}: {error}")
            if was_open and self._clock.mono() - opened >= STEADY_S:
                backoff.reset()
            if self._clock.wait(self._soon, backoff.next_s()) and not self._stopping.is_set():
                self._soon.clear()
                backoff.reset()

    def _live(self, channel: Channel) -> None:
        """Serve an open channel until PHM stops or requests reopening. Raises OSError when it is lost."""
        try:
            if channel.proven or self._fact is None:
                self._set_state(is_open=True)
            self._received = self._clock.mono()
            self._queue.expire()
            self._again.clear()
            self._soon.clear()
            if self._stopping.is_set():
                self._soon.set()
            self._opened += 1
            while not self._stopping.is_set():
                self._turn(channel, IDLE_S)
                if self._again.is_set():
                    return
                if self._clock.mono() - self._received > SILENT_S:
                    self._received = self._clock.mono()
                    if self._opener.moved():
                        return
            self._farewell(channel)
        finally:
            self._read_at = None
            channel.close()

    def _farewell(self, channel: Channel) -> None:
        """Send what is queued, and repeat a POWEROFF: if its frame is lost, the other agents take this one for lost."""
        began, repeats = self._clock.mono(), 0
        while (passed_s := self._clock.mono() - began) < FAREWELL_S:
            beat = self._last_heartbeat
            again = beat is not None and beat.system_status == mavlink.MAV_STATE_POWEROFF and repeats < REPEATS
            if again and passed_s >= (repeats + 1) * REPEAT_S:
                self._queue.put(beat, self.codec.size(beat))
                repeats += 1
            elif channel.ready and not (again or self._queue):
                return
            self._turn(channel, 0.02)

    def _turn(self, channel: Channel, timeout_s: float) -> None:
        """Wait until there is something to do, and do it."""
        for fd, events in polling.wait([(self._bell.fd, polling.READ), *channel.polls()], timeout_s):
            if fd == self._bell.fd:
                self._bell.silence()
                continue
            for message in channel.serve(fd, events):
                self._received = self._clock.mono()
                self._set_state(is_open=True)
                if message.get_msgId() == RADIO_STATUS:
                    if not self._radio:
                        continue  # there is no radio that could have sent it
                    self._queue.txbuf(message.txbuf)
                self._deliver(message, self.name)
        self._read_at = self._clock.mono()
        self._write(channel)
        if self._clock.mono() - self._polled >= IDLE_S:
            self._line = channel.line()
            self._observe()

    def _write(self, channel: Channel) -> None:
        while channel.ready and (item := self._queue.take()) is not None:
            try:
                frame = self.codec.pack(item.message)
            except Exception:  # a message that cannot be packed is a defect of PHM; the link is OK
                self.codec.counters.dropped += 1
                logger.exception("a MAVLink message could not be packed")
                continue
            try:
                taken = channel.write(frame)
            except OSError:
                self._queue.give_back(item)
                raise
            if item.message.get_msgId() == HEARTBEAT:
                self._last_heartbeat = item.message
            if taken:
                self.codec.counters.sent += 1
                self.codec.counters.bytes_out += taken * len(frame)
                self._sent(item.message, frame)
                self._set_state(is_open=True)

    def _set_state(self, *, is_open: bool, error: str = "", code: int = 0) -> None:
        old = self._fact
        failed = 0 if is_open or (old is not None and old.open) else 1 + (old.failed if old is not None else 0)
        self._fact = LinkFact(self.name, is_open, error, code, failed=failed)
        if (old is None or old.open) and not is_open:
            logger.info("MAVLink endpoint %s is closed: %s", self.name, error)
        if old is None or not (old.open and is_open):
            self._observe()

    def _observe(self) -> None:
        self._polled = self._clock.mono()
        self._changed()

    def _ring(self) -> None:
        self._bell.ring()
