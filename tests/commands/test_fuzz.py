"""Hostile bytes from the parser to the command handler: no action, no exception, no change of state."""

from __future__ import annotations

import random
from typing import Any

from hypothesis import HealthCheck, assume, example, given, settings as hypothesis_settings, strategies as st

from phm.commands.handler import CommandHandler
from phm.commands.mavlink_commands import MAX_WAITING, MavlinkCommands
from phm.commands.services import CommandServices
from phm.testing import FakeClock, settings
from phm.transport.dialect import mavlink
from phm.transport.mavlink_codec import Codec
from phm.transport.mavlink_signing import Signer, Signing, unsigned_of
from phm.transport.priority import MessagePriority
from tests.commands.test_signing import KEY, NOW, OTHER, sign, ticks
from tests.fakes.mavlink import Sender, heartbeat, is_reply

ALL = ["status", "details", "check", "approve", "restart"]
IDS = frozenset((0, 75, 76, 109, 385))
HARD = hypothesis_settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.too_slow])


class Scene:
    """Everything from the bytes of a link to the command; all is permitted, and signing is on unless disabled."""

    def __init__(self, *, signs: bool = True) -> None:
        self.clock, self.did, self.acks, self.message_received = FakeClock(utc=NOW), [], [], 0  # type: ignore[var-annotated]
        self.system_id, self.component_id, self.agents, self.signs = 7, 193, 1, signs
        self.signing = Signing(KEY, self.clock)
        signer = Signer(self.signing, 0, unsigned_of("vehicle")) if signs else None
        self.codec = Codec(7, 193, IDS.__contains__, signer)
        self.parser = self.codec.parser()
        services = CommandServices(
            tuple,
            tuple,
            tuple,
            lambda: True,
            lambda: True,
            run_checks=lambda: self.did.append("look"),
            approve=lambda name: self._do(name),
            restart=lambda key, by: self._do(key),
            note=lambda kind, words: None,
            later=TimeoutError,
        )
        chosen = settings(agent={"id": 7}, containers=[{"name": "app"}], mavlink={"commands": ALL})
        self.handler = MavlinkCommands(
            self, CommandHandler(services, ["app"], self.clock), services, chosen.mavlink, 7, self.clock
        )
        self.handler.listen()

    def _do(self, what: str) -> str:
        self.did.append(what)
        return what

    def send(
        self,
        message: Any,
        kind: MessagePriority = MessagePriority.TRANSITION,
        *,
        key: str = "",
        urgency: int = 0,
        link: str = "",
    ) -> None:
        if message.get_type() == "COMMAND_ACK":
            self.acks.append(message.result)
        elif not is_reply(message):
            self.did.append(message.get_type())

    def listen(self, callback: Any, ids: Any) -> None:
        self.callback = callback

    def feed(self, data: bytes, *, datagram: bool = False) -> None:
        for message in (self.parser.datagram if datagram else self.parser.feed)(data):
            self.message_received += 1
            if message.get_msgId() in (75, 76):
                self.callback(message, "radio")
        self.handler.tick()

    def state(self) -> tuple[object, ...]:
        """The state that hostile bytes must not change."""
        return dict(self.signing._streams), self.signing._time, dict(self.handler._repeats), list(self.did)

    def accepts_valid_command(self) -> bool:
        """Whether a valid command is still accepted after any input."""
        before = len(self.did)
        # A parser may wait for the rest of an announced frame: the longest has 280 bytes.
        for n in range(40):
            self.clock.advance(3.0)
            frame = command(ticks(self.clock.utc()) + n)
            self.feed(frame if self.signs else Sender(255, 190).frame(RESTART))
            if len(self.did) > before:
                return True
        return False


RESTART = mavlink.MAVLink_command_long_message(7, 193, 31010, 0, 3, 1, 0, 0, 0, 0, 0)


def command(time: int, *, key: bytes = KEY) -> bytes:
    return sign(Sender(255, 190).frame(RESTART), time, key=key)


def test_a_valid_command_is_executed() -> None:
    """Without this the rest of the file would prove nothing."""
    scene = Scene()
    scene.feed(command(ticks(NOW)))
    assert (scene.did, scene.acks) == (["app"], [0])


@HARD
@given(st.binary(max_size=2000), st.booleans(), st.booleans())
def test_noise_does_nothing(data: bytes, datagram: bool, signs: bool) -> None:
    """Also with signing off; and the link still works."""
    scene = Scene(signs=signs)
    before = scene.state()
    scene.feed(data, datagram=datagram)
    assert scene.state() == before
    assert scene.accepts_valid_command()


@HARD
@given(st.lists(st.tuples(st.integers(0, 62), st.integers(0, 255)), min_size=1, max_size=8), st.booleans())
@example([(2, 1)], False)
def test_a_modified_signed_command_is_not_executed(changes: list[tuple[int, int]], datagram: bool) -> None:
    """Whichever bytes are changed, including flags, lengths and the signature."""
    frame = bytearray(command(ticks(NOW)))
    original = bytes(frame)
    for at, value in changes:
        frame[at % len(frame)] ^= value
    if bytes(frame) == original:
        return
    scene = Scene()
    before = scene.state()
    scene.feed(bytes(frame), datagram=datagram)
    assert scene.state() == before
    assert 0 not in scene.acks


@HARD
@given(st.data())
def test_a_command_with_valid_checksum_and_wrong_signature_is_not_executed(data: st.DataObject) -> None:
    """The attacker knows the standard: any payload, any time, any link id, any sender, another key or none."""
    scene = Scene()
    before = scene.state()
    numbers = st.integers(0, 255)
    for _ in range(data.draw(st.integers(1, 10))):
        params = [data.draw(st.floats(width=32)) for _ in range(2)]
        message = mavlink.MAVLink_command_long_message(
            data.draw(st.sampled_from([7, 0, 8])),
            data.draw(st.sampled_from([193, 0, 1])),
            data.draw(st.sampled_from([31010, 511, 512, 400, 0, 65535])),
            data.draw(numbers),
            *params,
            0,
            0,
            0,
            0,
            0,
        )
        frame = Sender(data.draw(numbers), data.draw(numbers)).frame(message)
        if data.draw(st.booleans()):
            frame = sign(frame, data.draw(st.integers(0, 2**48 - 1)), key=OTHER, link=data.draw(numbers))
        scene.feed(frame)
    assert scene.state() == before
    assert 0 not in scene.acks
    assert scene.accepts_valid_command()


@HARD
@given(st.lists(st.integers(1, 62), min_size=1, max_size=5), st.binary(max_size=300))
def test_a_truncated_command_is_not_executed(cuts: list[int], noise: bytes) -> None:
    """Whatever follows it; and a valid one after that is."""
    scene = Scene()
    before = scene.state()
    whole = command(ticks(NOW))
    pieces = [whole[: cut % len(whole)] + noise for cut in cuts]
    assume(not any(whole in piece for piece in pieces))  # noise can be the very byte that was cut off
    for piece in pieces:
        scene.feed(piece, datagram=True)
    assert scene.state() == before
    scene.feed(whole, datagram=True)
    assert scene.did == ["app"]


@HARD
@given(
    st.lists(st.integers(1, 64), max_size=20), st.binary(max_size=100).filter(lambda data: not {0xFD, 0xFE} & set(data))
)
def test_a_fragmented_valid_command_is_executed_once(sizes: list[int], noise: bytes) -> None:
    """In any fragments, and among bytes that start no frame."""
    scene = Scene()
    stream = noise + command(ticks(NOW))
    for size in [*sizes, len(stream)]:
        scene.feed(stream[:size])
        stream = stream[size:]
    assert scene.did == ["app"]


@HARD
@given(st.integers(0, 2**32 - 1))
def test_a_replay_does_nothing(seed: int) -> None:
    """A recording of valid frames, repeated in any order, cut and modified."""
    rng = random.Random(seed)
    scene, now = Scene(), ticks(NOW)
    frames = [sign(Sender(255, 190).frame(heartbeat()), now), command(now + 1), command(now + 2), command(now + 3)]
    for frame in frames:
        scene.feed(frame)
    before = scene.state()
    for _ in range(20):
        frame = bytearray(rng.choice(frames))
        if rng.random() < 0.5:
            frame[rng.randrange(len(frame))] ^= 1 << rng.randrange(8)
        scene.feed(bytes(frame[: rng.randrange(1, len(frame) + 1)] if rng.random() < 0.3 else frame))
    assert scene.state() == before


@HARD
@given(st.lists(st.tuples(st.integers(0, 255), st.integers(0, 255), st.integers(0, 255)), max_size=300))
def test_a_flood_leaves_room_for_a_valid_command(floods: list[tuple[int, int, int]]) -> None:
    """Unsigned commands of any sender, including the ground station's identity."""
    scene = Scene()
    for system, component, again in floods:
        message = mavlink.MAVLink_command_long_message(7, 193, 31010, again, 3, 1, 0, 0, 0, 0, 0)
        for message_received in scene.parser.feed(Sender(system, component).frame(message)):
            scene.callback(message_received, "radio")
        assert len(scene.handler._waiting) <= MAX_WAITING
    scene.feed(command(ticks(NOW)))
    assert scene.did == ["app"]
