"""The simulated autopilot and ground station behave like the real ones, with PHM's MAVLink hub beside them."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from phm.core.clock import SystemClock
from phm.core.model import Level, Slot
from phm.probes.links import Links
from phm.simulation.autopilot import SimulatedAutopilot
from phm.simulation.mavlink_port import Port, mavlink
from phm.testing import settings
from phm.transport.mavlink import MavlinkHub
from phm.wire import status_word
from sitl.simulation.ground import Ground, TextLine, WordChange, as_text
from tests.fakes.mavlink import Sender, free_port, heartbeat, text
from tests.fakes.until import until


class Flight:
    """Autopilot 7 with a companion port and a ground port on loopback, and PHM's hub and probe beside it."""

    def __init__(self) -> None:
        self.companion, self.ground_port = free_port(), free_port()
        self.pilot = self._pilot()
        chosen = settings(agent={"id": 7}, mavlink={"endpoints": [{"url": f"tcp:127.0.0.1:{self.companion}"}]})
        self.hub = MavlinkHub(chosen.mavlink, 7, SystemClock())
        self.links = Links(self.hub, chosen.agent.id, chosen.mavlink, SystemClock(), lambda: None)
        self.ground = Ground(f"tcp:127.0.0.1:{self.ground_port}")
        self.hub.start()
        self.hub.send(text("PHM is here"))  # the autopilot forwards nothing to a silent port
        self.ground.start()

    def _pilot(self) -> SimulatedAutopilot:
        companion, ground = (f"tcpin:127.0.0.1:{port}" for port in (self.companion, self.ground_port))
        pilot = SimulatedAutopilot(7, companion, ground, reboot_s=1.0, stream_hz=4.0)
        self._thread = threading.Thread(target=pilot.run, daemon=True)
        self._thread.start()
        return pilot

    def restart_pilot(self) -> None:
        self.pilot.stop()
        self._thread.join(60)
        self.pilot = self._pilot()

    def close(self) -> None:
        self.ground.stop()
        self.hub.close()
        self.pilot.stop()
        self._thread.join(60)


@pytest.fixture
def flight() -> Iterator[Flight]:
    made = Flight()
    yield made
    made.close()


def test_status_texts_and_status_words_reach_the_ground_through_the_autopilot(flight: Flight) -> None:
    """Messages that PHM sends to the autopilot arrive at the ground station with identity, severity and status
    unchanged.
    """
    until(lambda: flight.links.gcs_age_s() is not None and (7, 1) in flight.ground.heartbeats)
    word = status_word.encode({Slot.NODES: Level.ERROR})
    flight.hub.send(heartbeat(word))
    flight.hub.send(text("A07 FAIL 6 node_1 dead", 2))
    line = until(lambda: [line for line in flight.ground.lines if "FAIL" in line.text])[0]
    assert (line.system, line.component, line.severity, line.text) == (7, 193, 2, "A07 FAIL 6 node_1 dead")
    change = until(lambda: list(flight.ground.words))[0]
    assert change.levels == {Slot.NODES: Level.ERROR}


def test_a_silent_ground_port_receives_only_the_autopilot(flight: Flight) -> None:
    """As measured on a real ArduPilot: frames are forwarded only to links that have sent a packet."""
    until(lambda: flight.links.autopilot() is not None)
    silent = Port(f"tcp:127.0.0.1:{flight.ground_port}")
    received: list[tuple[int, int]] = []

    def listen() -> bool:
        flight.hub.send(text("for everybody"))
        for sock in silent.sockets():
            received.extend(
                (message.get_srcSystem(), message.get_srcComponent()) for _, message in silent.receive(sock)
            )
        return received.count((7, 1)) > 6 and len(flight.ground.lines) > 6

    until(listen)
    assert set(received) == {(7, 1)}
    silent.send(Sender(254, 190).frame(heartbeat(kind=6)))
    until(lambda: listen() and (7, 193) in received)
    silent.close()


def test_the_ground_arms_and_the_companion_sees_it(flight: Flight) -> None:
    """The arm command is acknowledged by a heartbeat with the armed bit, which the link probe reads."""
    for armed in (True, False):
        until(lambda: flight.links.autopilot() is not None and (7, 1) in flight.ground.heartbeats)
        flight.ground.arm(7, armed=armed)
        until(lambda wanted=armed: (fact := flight.links.autopilot()) is not None and fact.armed is wanted)  # type: ignore[misc]


def test_both_sides_reconnect_after_an_autopilot_reboot(flight: Flight) -> None:
    """After a reboot of the autopilot PHM and the ground station reconnect and lines arrive again."""
    until(lambda: flight.links.autopilot() is not None)
    flight.restart_pilot()

    def received() -> bool:
        flight.hub.send(text("after the reboot"))
        return any(line.text == "after the reboot" for line in flight.ground.lines)

    until(received)


def test_an_autopilot_reboots_on_command(flight: Flight) -> None:
    """It acknowledges, is silent for a moment, disarmed after it, and its time since boot restarts."""
    flight.pilot.armed = True
    until(lambda: (fact := flight.links.autopilot()) is not None and fact.armed and (fact.boot_s or 0.0) > 4.0)
    ground = Port(f"tcp:127.0.0.1:{flight.ground_port}")
    ground.send(Sender(255, 190).frame(mavlink.MAVLink_command_long_message(7, 1, 246, 0, 1, 0, 0, 0, 0, 0, 0)))
    until(lambda: (fact := flight.links.autopilot()) is not None and fact.reboots == 1 and fact.rebooted_armed)
    until(lambda: (fact := flight.links.autopilot()) is not None and not fact.armed)
    ground.close()


def test_radio_status_stays_with_the_autopilot(flight: Flight) -> None:
    """As in ArduPilot's routing: a radio on one port is not forwarded to another."""
    until(lambda: flight.links.gcs_age_s() is not None)
    radio = Port(f"tcp:127.0.0.1:{flight.ground_port}")
    sender = Sender(51, 68)
    radio.send(sender.frame(mavlink.MAVLink_radio_status_message(180, 170, 98, 40, 50, 0, 0)))

    def received() -> bool:
        """The newest ground station, which the other one is again after its next heartbeat."""
        radio.send(sender.frame(heartbeat(kind=mavlink.MAV_TYPE_GCS)))
        return (gcs := flight.links.gcs()) is not None and gcs.system == 51

    until(received)
    assert flight.links.radios() == ()
    radio.close()


def test_forged_frames_of_the_autopilot_are_dropped(flight: Flight) -> None:
    """Component 1 of the vehicle's own system is not forwarded."""
    until(lambda: flight.links.gcs_age_s() is not None)
    liar = Port(f"tcp:127.0.0.1:{flight.companion}")
    liar.send(Sender(7, 1).frame(text("I am the autopilot")))
    liar.send(Sender(7, 42).frame(text("I am not")))
    until(lambda: any(line.text == "I am not" for line in flight.ground.lines))
    assert all(line.text != "I am the autopilot" for line in flight.ground.lines)
    liar.close()


def test_terminal_output_contains_no_control_characters() -> None:
    """Received text is shown without control characters; a status of another version is shown as such."""
    line = as_text(TextLine(0.0, 0.0, 7, 193, 2, "A07 \x1b[2J FAIL"))
    assert "\x1b" not in line
    assert "CRITICAL" in line
    assert "version 3" in as_text(WordChange(0.0, 0.0, 7, 193, 0xC0000001, 4))
