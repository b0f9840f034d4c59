"""What the link probe says: the ground station, radios, the autopilot, and the MAVLink endpoints themselves.

Part of `phm.facts`, and imported from there. Times named `age_s` are seconds before the call on the monotonic clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol


@dataclass(frozen=True, slots=True)
class GcsFact:
    """Of the last HEARTBEAT of any ground station. link: the name of the endpoint that it came by."""

    age_s: float
    system: int = 0
    component: int = 0
    link: str = ""
    due_s: float | None = None
    """It was never silent for nearly so long of late; None: it has not been received steadily for long enough."""
    overdue: bool = False
    """Silent for longer than that, while its link was open and read."""
    not_counted_s: float = 0.0
    """Of age_s, the time in which PHM did not run or had not read its link."""

    @property
    def silent_s(self) -> float:
        """What of its age is its silence."""
        return max(0.0, self.age_s - self.not_counted_s)


@dataclass(frozen=True, slots=True)
class AutopilotFact:
    """Of the last HEARTBEAT of the vehicle's autopilot component, by a link that leads to it.

    armed: as it last said by any of these links; armed when they differ.
    """

    age_s: float
    armed: bool
    custom_mode: int = 0
    system_status: int = 0
    link: str = ""
    """Name of the endpoint that it came by."""
    boot_s: float | None = None
    """How long it had run, by the newest time since boot that it reported; None: it reports none."""
    reboots: int = 0
    """How often that time was seen to start again."""
    rebooted_s: float | None = None
    """Since the last of these was seen; None: never."""
    rebooted_armed: bool = False
    """It was armed when it was last heard before that."""
    due_s: float | None = None
    overdue: bool = False
    """Both as in `GcsFact`; not overdue while other frames of it still come."""
    quiet_s: float | None = None
    """Since the last of its frames that PHM reads; None: not known."""
    armed_s: float | None = None
    """Since a HEARTBEAT of it last said armed, by any link that leads to it; None: none ever did."""
    disarmed_s: float | None = None
    """The same of one that said disarmed."""
    stalled_s: float | None = None
    """Since PHM last read again after it had been suspended: what it reads then may be old. None: never."""
    boot_age_s: float | None = None
    """Since it reported its time since boot; None: never."""
    disarmed_for_s: float | None = None
    """How long its heartbeats have said disarmed without a pause and nothing else; None: the newest one says armed."""
    not_counted_s: float = 0.0
    """As in `GcsFact`."""

    @property
    def silent_s(self) -> float:
        """What of its age is its silence."""
        return max(0.0, self.age_s - self.not_counted_s)


@dataclass(frozen=True, slots=True)
class RadioFact:
    """RADIO_STATUS of the radio that one endpoint leads to. Signal and noise in the radio's own units, 0 to 254: on SiK
    radios dBm = value / 1.9 - 127. None where it says that it does not know.
    """

    link: str
    age_s: float
    due_s: float
    """Seconds between reports, as they come or, before that is known, between PHM's heartbeats: a SiK radio sends a report
    for each HEARTBEAT that is given to it to send."""
    rssi: int | None = None
    remrssi: int | None = None
    noise: int | None = None
    remnoise: int | None = None
    txbuf: int = 100
    """Percent of the transmit buffer that is free."""
    margin: float | None = None
    """Signal over noise on board, the mean of the newest reports."""
    remmargin: float | None = None
    """The same at the other end of the radio link."""
    rxerrors_s: float | None = None
    """Packets that came damaged, a second; None before the second report."""
    fixed_s: float | None = None
    """Packets that came damaged and could be corrected, a second."""
    alone: bool = False
    """It says that it no longer hears the radio at the other end, which it did hear."""
    not_counted_s: float = 0.0
    """As in `GcsFact`."""

    @property
    def silent_s(self) -> float:
        """What of its age is its silence."""
        return max(0.0, self.age_s - self.not_counted_s)


@dataclass(frozen=True, slots=True)
class SenderFact:
    """Somebody heard on an endpoint. age_s: since the last frame, to half a second, without the time in which PHM did not run."""

    system: int
    component: int
    age_s: float
    frames: int
    """Seen in the window over which loss is counted."""
    loss_percent: float | None
    """By gaps in the sequence numbers; None: too few frames."""


@dataclass(frozen=True, slots=True)
class LineFact:
    """What the driver of a serial port counted, a second."""

    framing_s: float
    overrun_s: float
    parity_s: float


@dataclass(frozen=True, slots=True)
class LinkFact:
    """One MAVLink endpoint. Rates are means over the last seconds; None: not known yet."""

    name: str
    open: bool
    error: str = ""
    """Why it is closed."""
    code: int = 0
    """The error number behind it, as in `errno`; 0: none."""
    rx_age_s: float | None = None
    """Since bytes came last, to half a second, without the time in which PHM did not run; None: none ever did."""
    rx_s: float | None = None
    """Bytes a second that came."""
    tx_s: float | None = None
    """Bytes a second that left."""
    frames_s: float | None = None
    """MAVLink frames a second that came."""
    bad_s: float | None = None
    """False starts and damaged frames a second."""
    senders: tuple[SenderFact, ...] = ()
    line: LineFact | None = None
    """Serial ports only, and only where the driver counts."""
    failed: int = 0
    """How often in a row it could not be opened since it was open."""


class LinkProbe(Protocol):
    def gcs_age_s(self) -> float | None:
        """Since the last HEARTBEAT of any ground station, as far as it counts as silence; None when none was ever heard."""

    def gcs(self) -> GcsFact | None:
        """None when no ground station was ever heard."""

    def autopilot(self) -> AutopilotFact | None:
        """None when no autopilot was ever heard."""

    def radios(self) -> Sequence[RadioFact]:
        """Radios that were heard, at most one for each endpoint."""

    def links(self) -> Sequence[LinkFact]:
        """Endpoints that were tried at least once."""

    def users(self, path: str) -> Sequence[str]:
        """Programs that have the serial port at `path` open, PHM left out, as far as PHM can see them. May be slow: ask when
        there is a reason. Raises CannotTell when the kernel does not answer."""
