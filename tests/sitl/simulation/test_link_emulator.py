"""The link emulator: how a link treats frames, what a vehicle's router forwards, who receives what, and its process."""

from __future__ import annotations

import random
import threading
from collections.abc import Iterator
from typing import Any

import pytest

from phm.simulation.autopilot_model import AutopilotModel
from phm.simulation.mavlink_port import Port, mavlink, messages, parser
from sitl.simulation.channel_model import BUFFER_BYTES, Conditions, Losses, Pipe
from sitl.simulation.frames import HEARTBEAT, RADIO_STATUS, Frame
from sitl.simulation.ground import Ground
from sitl.simulation.link_emulator import LinkEmulator
from sitl.simulation.mesh import Mesh
from sitl.simulation.ports import Ports
from sitl.simulation.vehicle import Vehicle
from sitl.swarm import control as control_client
from sitl.swarm.control import LinkEmulatorClient
from tests.fakes.until import until


def pipe(*, filled: bool = False, **how: Any) -> Pipe[str]:
    """A link of 8000 bytes/s without delay by default."""
    return Pipe(Conditions(**{"delay_s": 0.0, "rate_bps": 64_000, **how}), random.Random(1), share=1.0, filled=filled)


# ---------------------------------------------------------------- one link


def test_a_frame_arrives_after_its_transmission_time_and_the_delay() -> None:
    """800 bytes at 8000 bytes/s take 0.1 s, plus the delay."""
    link = pipe(delay_s=0.5)
    assert link.offer(10.0, 800, "a")
    assert link.arrived(10.59) == []
    assert link.next_s() == pytest.approx(10.6)
    assert link.arrived(10.61) == ["a"]
    assert link.next_s() is None


def test_frames_share_the_rate() -> None:
    """Each waits for the previous one, so a burst takes as long as its bytes need; the order is kept."""
    link = pipe()
    for name in "abc":
        link.offer(0.0, 400, name)
    assert link.arrived(0.11) == ["a", "b"]
    assert link.arrived(0.16) == ["c"]


def test_a_sik_pair_has_the_measured_rate() -> None:
    """An air data rate of 64 kbit/s gives 3170 bytes/s each way (docs/reference/mavlink.md)."""
    link: Pipe[int] = Pipe(Conditions(delay_s=0.0), random.Random(1))
    arrived = 0
    for step in range(1000):
        now = step / 100
        link.offer(now, 50, step)
        arrived += 50 * len(link.arrived(now))
    assert arrived / 10 == pytest.approx(3170, rel=0.05)


def test_a_full_buffer_drops_frames() -> None:
    """A frame that does not fit is dropped entirely and counted; txbuf is the free share."""
    link = pipe(rate_bps=100)
    assert link.free_percent(0.0) == 100
    for _ in range(4):
        assert link.offer(0.0, BUFFER_BYTES // 4, "x")
    assert link.free_percent(0.0) == 0
    assert not link.offer(0.0, 1, "y")
    assert link.full == 1


def test_a_cut_link_buffers_frames_and_sends_them_afterwards() -> None:
    """As in a SiK radio: the buffer fills up, and is sent once the link is back."""
    link = pipe()
    link.conditions.cut = True
    link.offer(0.0, 800, "a")
    assert link.arrived(60.0) == []
    assert link.free_percent(60.0) < 100
    link.conditions.cut = False
    assert link.arrived(60.05) == []
    assert link.arrived(60.2) == ["a"]


@pytest.mark.parametrize("burst", [1.0, 5.0])
def test_the_share_of_lost_frames_is_the_configured_one(burst: float) -> None:
    """In the long run the share is `loss`, with or without bursts; and bursts have the configured length."""
    losses = Losses(random.Random(3))
    drawn = [losses.next(0.2, burst) for _ in range(40_000)]
    assert sum(drawn) / len(drawn) == pytest.approx(0.2, abs=0.02)
    starts = sum(now and not before for before, now in zip([False, *drawn], drawn, strict=False))
    expected = burst if burst > 1 else 1 / 0.8
    assert sum(drawn) / starts == pytest.approx(expected, rel=0.1)


def test_lost_frames_are_counted_and_not_delivered() -> None:
    """With a loss of 1 nothing arrives."""
    link = pipe(loss=1.0)
    link.offer(0.0, 80, "a")
    assert link.arrived(9.0) == []
    assert link.lost == 1


def test_foreign_traffic_fills_the_buffer() -> None:
    """With more than the link can carry, txbuf falls to zero; without it the buffer is soon empty again."""
    link = pipe(filled=True, fill_bps=640_000)
    for step in range(100):
        link.arrived(step / 10)
    assert link.free_percent(10.0) < 5
    link.conditions.fill_bps = 0.0
    assert link.free_percent(20.0) == 100


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"loss": 2}, "0 to 1"),
        ({"cut": 1}, "true and false"),
        ({"burst": 0.5}, "1 to 1000"),
        ({"colour": 3}, "no 'colour'"),
        ({"rate_bps": "fast"}, "rate_bps is 'fast'"),
    ],
    ids=lambda value: str(value),
)
def test_invalid_link_settings_are_rejected_entirely(values: dict[str, Any], said: str) -> None:
    """The message states what is allowed, and no setting is applied."""
    conditions = Conditions()
    with pytest.raises(ValueError, match=said):
        conditions.change({"delay_s": 1.0, **values})
    assert conditions == Conditions()


# ---------------------------------------------------------------- one vehicle


def framed(message: Any, system: int, component: int) -> Frame:
    """A message as another system sends it, decoded again."""
    raw = message.pack(mavlink.MAVLink(None, srcSystem=system, srcComponent=component))
    return Frame.of(messages(parser(), raw)[0])


def heartbeat(system: int, component: int) -> Frame:
    return framed(mavlink.MAVLink_heartbeat_message(18, 8, 0, 0, 4, 3), system, component)


def vehicle(*, pilot: bool = False) -> Vehicle:
    return Vehicle(3, 0.0, random.Random(1), AutopilotModel(3, 0.0, stream_hz=4.0) if pilot else None)


def kinds(one: Vehicle, place: str) -> list[int]:
    """Ids of the messages that arrived there since the last call; asserts that nothing else remains."""
    found = [Frame.of(messages(parser(), raw)[0]).kind for where, raw in one.out if where == place]
    one.out = [entry for entry in one.out if entry[0] != place]
    return found


def test_the_router_forwards_broadcasts() -> None:
    """PHM's heartbeat goes to the autopilot and, over the radio link, to the ground; not back to PHM."""
    one = vehicle()
    one.take(0.0, "phm", heartbeat(3, 193))
    one.tick(1.0)
    assert kinds(one, "pilot") == [HEARTBEAT, RADIO_STATUS]
    assert kinds(one, "ground") == [HEARTBEAT]
    assert kinds(one, "phm") == [RADIO_STATUS]


def test_a_radio_answers_each_local_heartbeat() -> None:
    """As system 51 component 68, also while the other radio is not received, with the free share of its buffer."""
    one = vehicle()
    one.ground.cut = True
    for second in range(40):
        one.take(float(second), "phm", heartbeat(3, 193))
    answers = [messages(parser(), raw)[0] for place, raw in one.out if place == "phm"]
    assert {(answer.get_srcSystem(), answer.get_srcComponent()) for answer in answers} == {(51, 68)}
    assert len(answers) == 40
    assert answers[-1].txbuf < answers[0].txbuf < 100
    assert kinds(one, "ground") == []


def test_a_radio_resets_the_remote_values_of_a_lost_radio() -> None:
    """Like SiK firmware, some seconds after the last packet; its own signal is reported unchanged."""
    one = vehicle()

    def signals(now: float) -> tuple[int, int, int]:
        one.out.clear()
        one.take(now, "phm", heartbeat(3, 193))
        (report,) = [messages(parser(), raw)[0] for place, raw in one.out if place == "phm"]
        return report.rssi, report.remrssi, report.remnoise

    assert signals(0.0) == (180, 180, 40)
    one.change("ground", {"cut": True})
    assert [signals(now) for now in (3.0, 3.6, 5.0)] == [(180, 180, 40), (180, 0, 0), (180, 0, 0)]
    one.change("ground", {"cut": False})
    assert signals(6.0) == (180, 180, 40)


def test_the_ground_radio_answers_too() -> None:
    """The ground station's heartbeat is answered with RADIO_STATUS immediately, and reaches PHM and the autopilot by
    radio.
    """
    one = vehicle()
    one.take(0.0, "ground", heartbeat(255, 190))
    one.tick(1.0)
    assert kinds(one, "ground") == [RADIO_STATUS]
    assert kinds(one, "phm") == [HEARTBEAT]
    assert kinds(one, "pilot") == [HEARTBEAT]


def test_an_addressed_message_goes_only_to_its_target() -> None:
    """A command for PHM does not reach the autopilot; one for an unknown target reaches no one."""
    one = vehicle()
    one.take(0.0, "phm", heartbeat(3, 193))
    one.take(0.0, "pilot", heartbeat(3, 1))
    one.tick(5.0)
    one.out.clear()
    for component, place in ((193, "phm"), (1, "pilot"), (77, "")):
        command = mavlink.MAVLink_command_long_message(3, component, 512, 0, 0, 0, 0, 0, 0, 0, 0)
        one.take(6.0, "ground", framed(command, 255, 190))
        one.tick(7.0)
        assert {where for where, _ in one.out} - {place} == set()
        assert bool(one.out) == bool(place)
        one.out.clear()


def test_damaged_packets_are_in_the_radio_status() -> None:
    """rxerrors grows with the loss of the link, as with a weak signal of a real radio."""
    one = vehicle()
    one.ground.loss = 0.5
    for second in range(1, 6):
        one.take(float(second), "phm", heartbeat(3, 193))
    answers = [messages(parser(), raw)[0] for place, raw in one.out if place == "phm"]
    errors = [answer.rxerrors for answer in answers]
    assert errors == sorted(errors)
    assert errors[-1] == pytest.approx(40, abs=2)


def test_a_radio_without_power_sends_nothing() -> None:
    """Neither RADIO_STATUS nor frames, either way."""
    one = vehicle()
    one.change("ground", {"off": True})
    one.take(0.0, "phm", heartbeat(3, 193))
    one.take(0.0, "ground", heartbeat(255, 190))
    one.tick(1.0)
    assert kinds(one, "phm") == []
    assert kinds(one, "ground") == [RADIO_STATUS]  # the ground radio has power


def test_a_killed_router_forwards_nothing() -> None:
    """Not between PHM and the autopilot either; `reset` restarts it."""
    one = vehicle(pilot=True)
    one.change("router", {"off": True})
    one.take(5.0, "phm", heartbeat(3, 193))
    assert one.out == []
    one.reset()
    one.tick(7.0)
    assert kinds(one, "phm")


def test_the_simulated_autopilot_executes_commands_through_the_router() -> None:
    """Arming from the ground: acknowledged to the ground, and PHM receives the armed state."""
    one = vehicle(pilot=True)
    one.take(0.0, "ground", heartbeat(255, 190))
    command = mavlink.MAVLink_command_long_message(3, 1, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
    one.take(0.1, "ground", framed(command, 255, 190))
    one.tick(0.5)
    one.tick(0.9)
    assert one.pilot is not None
    assert one.pilot.armed
    assert mavlink.MAVLINK_MSG_ID_COMMAND_ACK in kinds(one, "ground")


def test_an_autopilot_reboots_disarmed_with_a_new_boot_time() -> None:
    """It is silent meanwhile; a hang lasts until it is ended."""
    one = vehicle(pilot=True)
    one.order(10.0, "arm", {})
    one.tick(10.0)
    one.order(10.0, "reboot", {"boot_s": 2.0})
    one.out.clear()
    one.tick(11.9)
    assert kinds(one, "phm") == []
    one.tick(12.1)
    receivers = [messages(parser(), raw)[0] for place, raw in one.out if place == "phm"]
    assert any(message.get_type() == "SYSTEM_TIME" and message.time_boot_ms < 1000 for message in receivers)
    assert one.state()["autopilot"] == {
        "off": False,
        "armed": False,
        "hung": False,
        "rebooting": False,
    }
    one.order(13.0, "hang", {})
    one.out.clear()
    one.tick(20.0)
    assert kinds(one, "phm") == []


# ---------------------------------------------------------------- between agents


def receivers(mesh: Mesh, now: float) -> set[int]:
    return {agent for agent, _ in mesh.tick(now)}


def test_all_others_receive_an_agent() -> None:
    """And it does not receive itself."""
    mesh = Mesh(range(1, 4), random.Random(1))
    mesh.take(0.0, 1, b"x" * 30)
    assert receivers(mesh, 1.0) == {2, 3}


def test_a_cut_or_split_acts_both_ways() -> None:
    """An agent that is cut neither sends nor receives; groups receive only themselves."""
    mesh = Mesh(range(1, 5), random.Random(1))
    mesh.change(2, {"cut": True})
    mesh.take(0.0, 1, b"x")
    mesh.take(0.0, 2, b"x")
    assert receivers(mesh, 1.0) == {3, 4}
    mesh.reset(2)
    assert receivers(mesh, 2.0) == set()
    mesh.split([[1, 2], [3]])
    mesh.take(3.0, 1, b"x")
    mesh.take(3.0, 3, b"x")
    mesh.take(3.0, 4, b"x")
    assert receivers(mesh, 4.0) == {2}
    mesh.split([])
    mesh.take(5.0, 4, b"x")
    assert receivers(mesh, 6.0) == {1, 2, 3}
    with pytest.raises(ValueError, match="each once"):
        mesh.split([[1], [1]])


# ---------------------------------------------------------------- the process


@pytest.fixture
def process(monkeypatch: pytest.MonkeyPatch) -> Iterator[LinkEmulator]:
    monkeypatch.setattr(control_client, "LIMIT_S", 60.0)  # on a busy machine an answer takes a while
    air = LinkEmulator(2, host="127.0.0.1", ports=Ports())
    thread = threading.Thread(target=air.run, name="air", daemon=True)
    thread.start()
    yield air
    air.stop()
    thread.join(60)
    assert not thread.is_alive()


def test_the_ground_receives_each_vehicle_and_phm_receives_radio_and_autopilot(process: LinkEmulator) -> None:
    """Over real sockets, with RADIO_STATUS, and counted."""
    control = LinkEmulatorClient(("127.0.0.1", process.control_port))
    ground = Ground(f"tcp:127.0.0.1:{process.station.bound_port}")
    ground.start()
    phm = Port(f"tcp:127.0.0.1:{process.routers[2].rpartition(':')[2]}")
    seen: set[str] = set()

    def both() -> bool:
        phm.send(heartbeat(2, 193).raw)
        for sock in phm.sockets():
            seen.update(message.get_type() for _, message in phm.receive(sock))
        return {"RADIO_STATUS", "HEARTBEAT"} <= seen and {(1, 1), (2, 1), (2, 193)} <= set(ground.heartbeats)

    until(both, "all messages")
    traffic = control.traffic()
    assert traffic[2]["phm_to_ground"] > 0
    assert traffic[1]["phm_to_ground"] == 0
    assert traffic[1]["to_ground"] > 0
    ground.stop()
    phm.close()


def test_a_killed_router_refuses_connections_and_returns_on_the_same_port(process: LinkEmulator) -> None:
    """So PHM sees `connection refused`, and reconnects later."""
    control, url = (
        LinkEmulatorClient(("127.0.0.1", process.control_port)),
        f"tcp:{process.routers[1].partition(':')[2]}",
    )
    phm = Port(url)
    until(lambda: control.state()["agents"][1]["router"]["connected"] == 1, "one connection to the router")
    control.set(1, "router", off=True)
    assert control.state()["agents"][1]["router"] == {"off": True, "connected": 0}
    with pytest.raises(ConnectionRefusedError):
        Port(url)
    control.reset(1)
    again = Port(url)
    until(lambda: control.state()["agents"][1]["router"]["connected"] == 1, "one connection to the router")
    phm.close()
    again.close()


def test_invalid_requests_are_answered_with_a_reason(process: LinkEmulator) -> None:
    """And the process continues."""
    control = LinkEmulatorClient(("127.0.0.1", process.control_port))
    for order, said in (
        (lambda: control.set(9, "ground", cut=True), "no agent 9: allowed are 1 to 2"),
        (lambda: control.set(1, "moon", cut=True), "no link 'moon'"),
        (lambda: control.set(1, "router", loss=0.5), "only `off`"),
        (lambda: control.autopilot(1, "land"), "cannot 'land'"),
        (lambda: control.split([[1, 7]]), "name agents of"),
    ):
        with pytest.raises(ValueError, match=said):
            order()
    assert process.answer(b"garbage")["error"]
    assert process.answer(b"[]")["error"]
    assert set(control.state()["agents"]) == {1, 2}
