"""Facts from the link probe about the ground station, radios, the autopilot, and the MAVLink endpoints themselves.

Part of `phm.facts`; import them from there. Times named `age_s` are seconds before the call on the monotonic clock.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

REBOOT_SILENCE_S = 3.5
"""After a longer silence an autopilot may have rebooted. A larger `mavlink.autopilot_timeout` does not change that."""


@dataclass(frozen=True, slots=True)
class GcsFact:
    """The last HEARTBEAT of the pilot's ground station (`mavlink.pilots`). link: name of the endpoint that received it."""

    age_s: float
    system: int = 0
    component: int = 0
    link: str = ""
    due_s: float | None = None
    """Timeout, well above its longest recent pause; None: it has not been received steadily for long enough."""
    overdue: bool = False
    """Whether it has been silent for longer than that, while its link was open and read."""
    not_counted_s: float = 0.0
    """The part of age_s in which PHM did not run or had not read its link."""
    left: bool = False
    """It announced its end, and no other one is known."""

    @property
    def silent_s(self) -> float:
        """The part of its age that counts as silence."""
        return max(0.0, self.age_s - self.not_counted_s)


@dataclass(frozen=True, slots=True)
class AutopilotFact:
    """The last HEARTBEAT of the vehicle's autopilot component, on a link that leads to it.

    armed: as last reported on any of these links; armed if they differ.
    """

    age_s: float
    armed: bool
    custom_mode: int = 0
    system_status: int = 0
    link: str = ""
    """Name of the endpoint that received it."""
    boot_s: float | None = None
    """How long it has been running, from the newest time since boot that it reported; None: it reports none."""
    reboots: int = 0
    """How often it was seen to reboot: by its time since boot, by the state BOOT in its HEARTBEAT, or by its message."""
    rebooted_s: float | None = None
    """Since the last of these reboots was seen; None: never."""
    rebooted_armed: bool = False
    """Whether it was armed when it was last received before that reboot, or before an earlier one of the same series."""
    due_s: float | None = None
    overdue: bool = False
    """Both as in `GcsFact`; not overdue while other frames from it still arrive."""
    quiet_s: float | None = None
    """Since the last frame from it that PHM reads; None: not known."""
    armed_s: float | None = None
    """Since a HEARTBEAT from it last reported armed, on any link that leads to it; None: never."""
    disarmed_s: float | None = None
    """The same for one that reported disarmed."""
    stalled_s: float | None = None
    """Since PHM last resumed reading after a suspension: what it reads then may be old. None: never."""
    boot_age_s: float | None = None
    """Since it last reported its time since boot; None: never."""
    disarmed_for_s: float | None = None
    """How long its heartbeats have reported disarmed only, without a pause; None: the newest one reports armed."""
    not_counted_s: float = 0.0
    """Has the same meaning as in `GcsFact`."""
    rebooting_s: float | None = None
    """Since it acknowledged a command to reboot; None: it has not, or it was seen to reboot since."""
    contradicted: bool = False
    """Its heartbeats reported armed and disarmed as no single vehicle does, and no landing was received since."""
    landed_s: float | None = None
    """Since a link changed to disarmed after it had reported nothing but armed for seconds; None: never."""

    @property
    def silent_s(self) -> float:
        """The part of its age that counts as silence."""
        return max(0.0, self.age_s - self.not_counted_s)


@dataclass(frozen=True, slots=True)
class RadioFact:
    """RADIO_STATUS of the radio behind one endpoint. Signal and noise are in the radio's own units, 0 to 254: on SiK
    radios dBm = value / 1.9 - 127. None: the radio reports the value as unknown.
    """

    link: str
    age_s: float
    due_s: float
    """Seconds between reports, as measured, or between PHM's heartbeats until that is known: a SiK radio sends one report
    for each HEARTBEAT that it is given to transmit."""
    rssi: int | None = None
    remrssi: int | None = None
    noise: int | None = None
    remnoise: int | None = None
    txbuf: int = 100
    """Free part of the transmit buffer in percent."""
    margin: float | None = None
    """Signal minus noise on board, mean of the newest reports."""
    remmargin: float | None = None
    """The same at the other end of the radio link."""
    rxerrors_s: float | None = None
    """Damaged packets received per second; None before the second report."""
    fixed_s: float | None = None
    """Damaged packets received and corrected per second."""
    alone: bool = False
    """It reports that it no longer receives the radio at the other end, which it did receive before."""
    not_counted_s: float = 0.0
    """Has the same meaning as in `GcsFact`."""

    @property
    def silent_s(self) -> float:
        """The part of its age that counts as silence."""
        return max(0.0, self.age_s - self.not_counted_s)


@dataclass(frozen=True, slots=True)
class SenderFact:
    """A sender received on an endpoint.

    age_s: since its last frame, to half a second, without the time in which PHM did not run.
    """

    system: int
    component: int
    age_s: float
    frames: int
    """Received within the window over which loss is counted."""
    loss_percent: float | None
    """From gaps in the sequence numbers; None: too few frames."""


@dataclass(frozen=True, slots=True)
class LineFact:
    """Errors per second that the driver of a serial port counted."""

    framing_s: float
    overrun_s: float
    parity_s: float


@dataclass(frozen=True, slots=True)
class LinkFact:
    """One MAVLink endpoint. Rates are averages over the last seconds; None: not known yet."""

    name: str
    open: bool
    error: str = ""
    """Why it is closed."""
    code: int = 0
    """The error number of the cause, as in `errno`; 0: none."""
    rx_age_s: float | None = None
    """Since the last bytes arrived, to half a second, without the time in which PHM did not run; None: none ever arrived."""
    rx_s: float | None = None
    """Bytes received per second."""
    tx_s: float | None = None
    """Bytes sent per second."""
    frames_s: float | None = None
    """MAVLink frames received per second."""
    bad_s: float | None = None
    """False start markers and damaged frames per second."""
    frame_bytes_s: float | None = None
    """Bytes per second of the frames in `frames_s`."""
    verified_s: float | None = None
    """The part of `frames_s` whose checksum PHM computed. It does so for messages that it reads, and for new senders."""
    senders: tuple[SenderFact, ...] = ()
    line: LineFact | None = None
    """Serial ports only, and only if the driver counts errors."""
    failed: int = 0
    """Number of consecutive failures to open it since it was last open."""


class LinkProbe(Protocol):
    """Reads the MAVLink endpoints and who was received on them."""

    def gcs_age_s(self) -> float | None:
        """Return the seconds since the last HEARTBEAT of any ground station that count as silence; None: never received."""

    def gcs(self) -> GcsFact | None:
        """Return None if no ground station was ever received."""

    def autopilot(self) -> AutopilotFact | None:
        """Return None if no autopilot was ever received."""

    def radios(self) -> Sequence[RadioFact]:
        """Return the radios that were received, at most one per endpoint."""

    def links(self) -> Sequence[LinkFact]:
        """Return the endpoints that PHM has tried to open at least once."""

    def users(self, path: str) -> Sequence[str]:
        """Return the programs other than PHM that have the serial port at `path` open, as far as PHM can see them.

        Can be slow: call it only when there is a reason. Raises CannotTell if the kernel does not answer.
        """
