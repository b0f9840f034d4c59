"""The messages of one topic: how many are examined, of which publishers, and what hostile ones cause."""

from __future__ import annotations

import random
from typing import Any

import pytest

from phm.facts import DataFact, FieldFact
from phm.probes.ros.data.data_monitor import MOST, DataMonitor, worst_of
from phm.probes.ros.data.decoder import Decoded, Decoder, Undecodable
from phm.probes.ros.protocol import WantedData, WantedRange
from phm.probes.ros.reader import RawMessage
from tests.fakes.ros_messages import SECOND, stamped

TICK_S = 0.25
NOW_NS = 1_700_000_000 * SECOND
ONE, TWO = b"1" * 16, b"2" * 16
TYPE, UNKNOWN = "my_msgs/msg/Odometry", "px4_msgs/msg/VehicleLocalPosition"


class FakeDecoder(Decoder):
    """A message's last byte is its counter; an odd one is out of range. `!` cannot be decoded, `?` lacks an element."""

    def __init__(self, wanted: WantedData, type_name: str) -> None:
        super().__init__(WantedData(), type_name)
        self.counter_bits, self.read_count = 8, 0
        self.stamped = None if type_name == UNKNOWN else False
        self._wanted = wanted

    @property
    def usable(self) -> bool:
        return bool(self._wanted.counter or self._wanted.ranges)

    def read(self, data: bytes) -> Decoded:
        self.read_count += 1
        if data.endswith(b"!"):
            raise Undecodable("a message cannot be decoded: no")
        outside = {"x": "1"} if self._wanted.ranges and data[-1] % 2 else {}
        problem = "no such element" if data.endswith(b"?") else ""
        return Decoded(data[-1], outside, data[:-1] + b"\0", (FieldFact("x", data[-1], data[-1]),), problem)


class Bench:
    def __init__(self, header: bool | None = True, rate_hz: float = 10.0, **wanted: Any) -> None:
        self.decoders: list[FakeDecoder] = []
        self.now_s, self.sequence = 50.0, 0
        self.monitor = DataMonitor(WantedData(**wanted), rate_hz, self._decoder, lambda _: header)

    def _decoder(self, wanted: WantedData, type_name: str) -> Decoder:
        self.decoders.append(FakeDecoder(wanted, type_name))
        return self.decoders[-1]

    def message(self, data: bytes, writer: bytes | None = ONE, sequence: int | None = -1) -> RawMessage:
        self.sequence += 1
        received_ns = NOW_NS + int(self.now_s * SECOND)
        return RawMessage(data, writer, received_ns, self.sequence if sequence == -1 else sequence)

    def stamped(self, content: bytes = b"", age_s: float = 0.0, **message: Any) -> RawMessage:
        return self.message(stamped(NOW_NS + int((self.now_s - age_s) * SECOND), content), **message)

    def poll(self, *messages: RawMessage, type_name: str = TYPE, **how: Any) -> DataFact:
        self.now_s += TICK_S
        self.monitor.update(self.now_s, type_name, messages, **how)
        assert self.monitor.fact is not None
        return self.monitor.fact


def test_a_field_has_the_values_of_all_publishers() -> None:
    """The newest of each, from the lowest to the highest."""
    bench = Bench(counter="seq", fields=("x",))
    bench.poll(bench.message(b"....\7"), bench.message(b"....\3", writer=TWO))
    fact = bench.poll(*(bench.message(b"....\5") for _ in range(2)))
    for _ in range(2):
        fact = bench.poll(bench.message(b"....\4"), bench.message(b"....\2", writer=TWO))
    assert fact.fields == (FieldFact("x", 2, 4),)
    facts = [DataFact(fields=(FieldFact("x", nan=True),)), DataFact(fields=(FieldFact("x", 1, 1, problem="no"),))]
    assert worst_of(facts).fields == (FieldFact("x", 1, 1, nan=True, problem="no"),)


def test_nothing_is_known_without_a_message() -> None:
    """There is no fact about a topic's data before its first message."""
    bench = Bench()
    bench.monitor.update(1.0, TYPE, [])
    assert bench.monitor.fact is None


def test_no_more_messages_are_examined_than_configured() -> None:
    """Two a second of each publisher, however many arrive, and only the newest ones."""
    bench = Bench(counter="seq", hz=2.0)
    for _ in range(40):
        fact = bench.poll(*(bench.message(b"....\7") for _ in range(50)))
    assert fact.samples == 20 == bench.decoders[0].read_count


def test_a_slow_topic_is_examined_completely() -> None:
    """The limit is one of messages, not of looks."""
    bench = Bench(frozen_s=10.0, hz=2.0, rate_hz=1.0)
    for number in range(20):
        fact = bench.poll(*([bench.stamped()] if number % 4 == 0 else []))
    assert fact.samples == 5


def test_stamps_are_compared_with_the_reception() -> None:
    """Not with the later time at which PHM took the message."""
    bench = Bench(max_age_s=0.5)
    for _ in range(10):
        fact = bench.poll(bench.stamped(age_s=3600.0))
    assert fact.conditions == ("data_stamp",) and fact.age_s == pytest.approx(3600.0) and not fact.unset


def test_a_stamp_that_was_never_set_is_reported() -> None:
    """As `unset`, so that no age is computed from it."""
    bench = Bench(max_age_s=0.5)
    for _ in range(10):
        fact = bench.poll(bench.message(stamped(0)))
    assert fact.conditions == ("data_stamp",) and fact.unset


def test_no_type_is_loaded_to_see_whether_it_begins_with_a_header(monkeypatch: pytest.MonkeyPatch) -> None:
    """The class of a type from `ros.installs` runs the application's code: the messages themselves show their header."""

    def never(name: str) -> None:
        raise AssertionError(f"{name} was loaded")

    monkeypatch.setattr("phm.probes.ros.data.decoder.load_decodable", never)
    monitor = DataMonitor(WantedData(order=True), 10.0)
    monitor.update(1.0, "absent_msgs/msg/Odometry", [RawMessage(stamped(7), None, 1, 1)])
    assert monitor.fact is not None and monitor.fact.problem == ""


def test_a_current_stamp_and_a_counter_do_not_hide_frozen_content() -> None:
    """Both change with every message."""
    bench = Bench(frozen_s=1.0, counter="seq")
    for number in range(8):
        fact = bench.poll(bench.stamped(b"same" + bytes((number,))))
    assert fact.conditions == ("data_frozen",)


def test_each_publisher_is_examined_alone() -> None:
    """One of two has frozen content, and the counter of the other has gaps: neither hides the other."""
    bench = Bench(frozen_s=1.0, counter="seq", hz=4.0)
    for number in range(10):
        frozen = bench.stamped(bytes((number,)), sequence=number)
        lossy = bench.stamped(bytes((number, 3 * number)), writer=TWO, sequence=number)
        fact = bench.poll(frozen, lossy, mixed=True)
    assert fact.conditions == ("data_frozen", "data_gaps") and fact.problem == ""


def test_publishers_that_cannot_be_distinguished_have_no_order() -> None:
    """Without their identity, stamps and counters of several publishers are mixed; ages are not."""
    bench = Bench(max_age_s=0.5, order=True, counter="seq", hz=4.0)
    for number in range(12):
        age_s = 5.0 if number % 2 else 0.0
        fact = bench.poll(bench.stamped(bytes((number,)), age_s, writer=None), mixed=True)
    assert fact.conditions == () and "cannot be distinguished" in fact.problem


def test_a_publisher_that_was_replaced_does_not_count() -> None:
    """The restarted node is another publisher; after 3 s, or three periods, only it counts."""
    bench = Bench(frozen_s=1.0)
    for _ in range(10):
        fact = bench.poll(bench.stamped(b"same"))
    assert fact.conditions == ("data_frozen",)
    for number in range(16):
        fact = bench.poll(bench.stamped(b"%d" % number, writer=TWO))
    assert fact.conditions == ()


def test_very_many_publishers_are_not_examined() -> None:
    """Anyone can publish on the topic under any number of identities."""
    bench = Bench(frozen_s=1.0, hz=4.0)
    fact = bench.poll(*(bench.stamped(writer=bytes((number,)) * 16) for number in range(100)))
    assert fact.samples == MOST


def test_numbers_and_a_text_of_an_unknown_type_are_not_a_header() -> None:
    """`int32 millivolt, uint32 milliampere, string id` reads like a header of 1970; its first numbers are its content."""
    bench = Bench(header=None, frozen_s=1.0)
    for number in range(20):
        stamp = (12_000 - 7 * number) * SECOND + 850 + number
        assert bench.poll(bench.message(stamped(stamp, frame=b"bat0"))).conditions == ()


@pytest.mark.parametrize("wanted", [{}, {"order": True}])
def test_the_header_of_an_unknown_type_does_not_hide_frozen_content(wanted: dict[str, Any]) -> None:
    """A stamp after the year 2000 shows a header. Where `order` or `max_age` says that there is one, every stamp is one."""
    bench = Bench(header=None, frozen_s=1.0, **wanted)
    for number in range(20):
        stamp = (number if wanted else 1_700_000_000 + number) * SECOND
        fact = bench.poll(bench.message(stamped(stamp, b"frame")))
    assert fact.conditions == ("data_frozen",)


def test_a_type_without_a_header_has_no_stamp() -> None:
    """A mistake of the configuration: it is named, and nothing is reported about the messages."""
    bench = Bench(header=False, max_age_s=0.5)
    fact = bench.poll(bench.message(stamped(0)))
    assert fact.problem == f"{TYPE} does not begin with a std_msgs/Header, so it has no stamp" and not fact.conditions


def test_content_of_any_type_can_be_frozen() -> None:
    """Also of one that PHM knows by its name alone, with and without a header."""
    for content in (b"text", stamped(1, b"x")):
        bench = Bench(header=None, frozen_s=1.0)
        for _ in range(10):
            fact = bench.poll(bench.message(content))
        assert fact.conditions == ("data_frozen",) and fact.problem == ""


def test_without_its_type_a_message_may_have_a_stamp_anywhere() -> None:
    """So that it always differs says nothing. A message that has repeated has no stamp, and one with a header has it there."""
    bench = Bench(header=None, frozen_s=1.0)
    for number in range(10):
        fact = bench.poll(bench.message(b"....%d" % number), type_name=UNKNOWN)
    assert fact.conditions == () and "frozen cannot be judged" in fact.problem and UNKNOWN in fact.problem
    for _ in range(10):
        fact = bench.poll(bench.message(b"....same"), type_name=UNKNOWN)
    assert (fact.conditions, fact.problem) == (("data_frozen",), "")
    for number in range(4):
        fact = bench.poll(bench.message(b"....%d" % number), type_name=UNKNOWN)
    assert (fact.conditions, fact.problem) == ((), "")
    bench = Bench(header=None, frozen_s=1.0)
    for number in range(10):
        fact = bench.poll(bench.stamped(b"%d" % number), type_name=UNKNOWN)
    assert (fact.conditions, fact.problem) == ((), "")


def test_a_message_that_cannot_be_decoded_is_named() -> None:
    """Until the next one that can."""
    bench = Bench(ranges=(WantedRange("x", 0.0, 1.0),), hz=4.0)
    assert "cannot be decoded" in bench.poll(bench.message(b"....!")).problem
    assert bench.poll(bench.message(b"....?")).problem == "no such element"
    assert bench.poll(bench.message(b"....\2")).problem == ""


def test_a_new_type_begins_again() -> None:
    """Its fields are other ones."""
    bench = Bench(frozen_s=1.0, counter="seq", hz=4.0)
    for _ in range(8):
        fact = bench.poll(bench.stamped(b"same\1"))
    assert fact.conditions == ("data_frozen",)
    assert bench.poll(bench.stamped(b"same\1"), type_name="my_msgs/msg/Other").conditions == ()
    assert len(bench.decoders) == 2


def test_hostile_messages_cause_no_exception() -> None:
    """Random bytes, stamps and counters, from changing publishers."""
    source = random.Random(7)
    bench = Bench(
        header=None, max_age_s=0.5, order=True, frozen_s=1.0, counter="seq", ranges=(WantedRange("x", 0, 1),), hz=4.0
    )
    for _ in range(300):
        messages = []
        for _ in range(source.randrange(4)):
            data = source.randbytes(source.randrange(1, 40))
            data = stamped(source.randrange(-(2**31), 2**31) * SECOND, data) if source.random() < 0.5 else data
            sequence = source.choice([None, source.randrange(2**63)])
            messages.append(RawMessage(data, source.choice([None, ONE, TWO]), source.randrange(2**63), sequence))
        bench.now_s += TICK_S
        bench.monitor.update(bench.now_s, TYPE, messages, mixed=source.random() < 0.5)
    assert bench.monitor.fact is not None and bench.monitor.fact.samples > 0
