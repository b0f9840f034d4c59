"""The examined messages of one publisher: when each limit counts as exceeded, and when no longer."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import pytest

from phm.facts import DataFact
from phm.facts.ros import OutsideFact
from phm.probes.ros.data.publisher_data import KEPT, Examined, PublisherData
from phm.probes.ros.protocol import WantedData

STEP_S = 0.5
"""Between two examined messages, at the default of two a second."""
PUBLISHED = 5
"""Publications between them, of a topic of 10 Hz."""


class Bench:
    """One publisher of 10 Hz, examined twice a second."""

    def __init__(self, bits: int | None = 32, **wanted: Any) -> None:
        self.publisher = PublisherData(WantedData(**wanted), bits)
        self.at_s, self.sequence = 100.0, 0

    def add(self, published: int = PUBLISHED, step_s: float = STEP_S, **message: Any) -> DataFact:
        self.at_s += step_s
        self.sequence += published
        self.publisher.add(Examined(self.at_s, self.sequence, **message))
        return self.publisher.fact()

    def each(self, key: str, values: Iterable[Any]) -> DataFact:
        fact = DataFact()
        for value in values:
            fact = self.add(**{key: value})
        return fact


def test_one_late_message_is_not_an_old_stamp() -> None:
    """Stamps must be too old in all messages for a second; and right again for as long."""
    bench = Bench(max_age_s=0.5)
    assert bench.each("age_s", [0.1, 0.1, 3.0, 0.1, 3.0, 3.0]).conditions == ()
    assert bench.each("age_s", [3.0]).conditions == ("data_stamp",)
    assert bench.each("age_s", [0.1, 0.1]).conditions == ("data_stamp",)
    assert bench.each("age_s", [0.1]).conditions == ()


@pytest.mark.parametrize("age_s", [3600.0, -3600.0])
def test_an_hour_off_is_reported_in_both_directions(age_s: float) -> None:
    """A stamp in the future is as wrong as an old one."""
    fact = Bench(max_age_s=0.5).each("age_s", [age_s] * 3)
    assert fact.conditions == ("data_stamp",) and fact.age_s == age_s


def test_an_age_at_its_limit_does_not_flap() -> None:
    """Reported stamps must come well below the limit."""
    bench = Bench(max_age_s=1.0)
    bench.each("age_s", [1.1] * 3)
    assert bench.each("age_s", [0.9, 1.1, 0.9, 0.9, 0.9]).conditions == ("data_stamp",)
    assert bench.each("age_s", [0.6] * 3).conditions == ()


def test_the_reported_age_is_that_of_a_wrong_stamp() -> None:
    """Until right stamps have lasted, a right one says nothing about what is reported."""
    bench = Bench(max_age_s=0.5)
    assert bench.each("age_s", [9.0, 9.0, 9.0, 0.1]).age_s == 9.0
    assert bench.each("age_s", [0.1, 0.2]).age_s == 0.2


def test_the_return_of_a_wrong_clock_is_in_order() -> None:
    """Its stamps were reported as wrong; that they are right again is not a second fault."""
    bench = Bench(max_age_s=0.5, order=True)
    for hour in (0, 3600, 3600, 3600, 0, 0, 0):
        fact = bench.add(age_s=-float(hour), stamp_ns=round((bench.at_s + hour) * 1e9))
    assert fact.conditions == () and fact.backs == 0


def test_stamps_that_go_back_count_for_a_while() -> None:
    """Among the newest messages, with the largest step; equal stamps are in order."""
    bench = Bench(order=True)
    fact = bench.each("stamp_ns", [10**9, 3 * 10**9, 3 * 10**9, 10**9])
    assert fact.conditions == ("data_order",) and (fact.backs, fact.back_s) == (1, 2.0)
    fact = bench.each("stamp_ns", [2 * 10**9, 10**9 + 1])
    assert (fact.backs, fact.back_s) == (2, 2.0)
    assert bench.each("stamp_ns", [10**10 + n for n in range(KEPT)]).conditions == ()


def test_order_is_examined_only_if_configured() -> None:
    """An age alone does not need it."""
    assert Bench(max_age_s=1e3).each("stamp_ns", [5, 4, 3]).conditions == ()


def test_the_same_content_for_too_long_is_frozen() -> None:
    """At least three messages; the first with other content ends it."""
    bench = Bench(frozen_s=1.0)
    assert bench.each("content", [b"a", b"b", b"b"]).conditions == ()
    fact = bench.each("content", [b"b"])
    assert fact.conditions == ("data_frozen",) and fact.frozen_s == 1.0
    assert bench.each("content", [b"c"]).conditions == ()
    assert bench.add(step_s=9.0, content=b"c").conditions == ()


def test_a_publisher_that_is_not_received_is_not_frozen() -> None:
    """Time without messages is silence: content must be received again."""
    bench = Bench(frozen_s=1.0)
    bench.each("content", [b"a", b"a"])
    assert bench.publisher.fact().conditions == ()


def test_half_of_the_numbers_missing_are_gaps() -> None:
    """The counter advances by two per publication: 50 %; and the condition ends with the gaps."""
    bench = Bench(counter="seq")
    counter = iter(range(0, 10**6, PUBLISHED))
    bench.each("counter", [next(counter) for _ in range(KEPT + 1)])
    assert bench.each("counter", [60, 70]).conditions == ()
    fact = bench.each("counter", [80])
    assert fact.conditions == ("data_gaps",)
    fact = bench.each("counter", [80 + 2 * PUBLISHED * n for n in range(1, KEPT + 1)])
    assert fact.lost_percent == pytest.approx(50.0)
    fact = bench.each("counter", [180 + PUBLISHED * n for n in range(1, KEPT + 1)])
    assert fact.conditions == () and fact.lost_percent == 0.0


def test_messages_that_phm_does_not_receive_are_no_gaps() -> None:
    """Only one message in five is examined here, and then one in a hundred: the publisher's own sequence numbers show it."""
    bench = Bench(counter="seq")
    bench.add(counter=0)
    total = 0
    for published in (5, 5, 100, 1, 250, 5, 5):
        total += published
        fact = bench.add(published, counter=total)
    assert fact.lost_percent == 0.0


@pytest.mark.parametrize("values", [(-1.7e308, 1.7e308), (float("nan"), 1.0), (float("inf"), float("inf"))])
def test_a_counter_without_a_finite_step_is_ignored(values: tuple[float, float]) -> None:
    """Any participant can publish such numbers, and a fact must have finite numbers."""
    bench = Bench(None, counter="seq")
    for value in values:
        assert math.isfinite(bench.add(counter=value).lost_percent or 0.0)
    assert bench.each("counter", [0, 2 * PUBLISHED]).lost_percent == 50.0


@pytest.mark.parametrize("bits", [8, 16, 32, 64])
def test_a_counter_may_wrap(bits: int) -> None:
    """From its largest value to its smallest, with and without gaps; of a signed one too."""
    for start in (2**bits - 12, 2 ** (bits - 1) - 12):
        bench = Bench(bits, counter="seq")
        numbers = [(start + PUBLISHED * n) % 2**bits for n in range(KEPT)]
        assert bench.each("counter", numbers).lost_percent == 0.0
        signed = [number - 2**bits if number >= 2 ** (bits - 1) else number for number in numbers]
        assert Bench(bits, counter="seq").each("counter", signed).lost_percent == 0.0
    bench = Bench(8, counter="seq")
    assert bench.each("counter", [2 * PUBLISHED * n % 256 for n in range(60)]).lost_percent == pytest.approx(50.0)


@pytest.mark.parametrize("bits", [32, None])
def test_a_restarted_source_has_no_gap(bits: int | None) -> None:
    """Its counter begins again, or at a random number: one interval, and a mean over time."""
    bench = Bench(bits, counter="seq")
    bench.each("counter", [PUBLISHED * n for n in range(KEPT)])
    fact = bench.each("counter", [0, *(PUBLISHED * n for n in range(1, 4))])
    assert fact.conditions == () and fact.lost_percent == 0.0
    fact = bench.each("counter", [10**8 + PUBLISHED * n for n in range(4)])
    assert fact.conditions == () and (fact.lost_percent or 0.0) < 20.0


def test_a_restarted_publisher_begins_again() -> None:
    """Its sequence numbers begin again: stamps, content and counter of the one before do not matter."""
    bench = Bench(order=True, frozen_s=1.0, counter="seq")
    for number in range(4):
        fact = bench.add(stamp_ns=10**12, content=b"x", counter=3 * number * PUBLISHED)
    assert fact.conditions == ("data_frozen", "data_gaps")
    bench.sequence = 0
    fact = bench.add(1, stamp_ns=0, content=b"x", counter=1)
    assert fact.conditions == () and fact.backs == 0 and fact.lost_percent is None
    assert bench.add(stamp_ns=1, content=b"x", counter=6).conditions == ()


def test_the_same_publication_counts_once() -> None:
    """A latched sample may be delivered again when a subscription is recreated."""
    bench = Bench(frozen_s=1.0)
    for _ in range(5):
        fact = bench.add(0, content=b"x")
    assert fact.conditions == ()


def test_a_single_value_out_of_range_is_not_reported() -> None:
    """Two of the newest messages are, with the newest value of each field."""
    bench = Bench()
    assert bench.each("outside", [{"x": "7"}, {}, {}]).conditions == ()
    fact = bench.each("outside", [{"x": "nan", "y": "-1"}])
    assert fact.conditions == ("data_range",)
    assert fact.outside == (OutsideFact("x", "nan"), OutsideFact("y", "-1"))
    assert bench.each("outside", [{}] * KEPT).conditions == ()


def test_without_sequence_numbers_gaps_are_unknown() -> None:
    """A middleware without them: the other limits count."""
    publisher = PublisherData(WantedData(counter="seq", frozen_s=0.5), 32)
    for number in range(4):
        publisher.add(Examined(float(number), None, content=b"x", counter=100 * number))
    assert publisher.fact().conditions == ("data_frozen",) and publisher.fact().lost_percent is None


def test_equal_content_from_the_start_is_not_decided() -> None:
    """Two equal messages of a new publisher do not show that the content changes; the first other one does."""
    bench = Bench(frozen_s=60.0)
    assert bench.each("content", [b"x", b"x"]).undecided == ("data_frozen",)
    assert bench.each("content", [b"y", b"y"]).undecided == ()
    bench.sequence = 0
    assert bench.add(1, content=b"y").undecided == ("data_frozen",)
    fact = bench.each("content", [b"y"] * 121)
    assert (fact.conditions, fact.undecided) == (("data_frozen",), ())


def test_stamps_are_decided_after_the_time_in_which_they_become_wrong() -> None:
    """A new child process has no memory of a wrong stamp."""
    bench = Bench(max_age_s=0.5)
    assert bench.each("age_s", [9.0, 9.0]).undecided == ("data_stamp",)
    fact = bench.each("age_s", [9.0])
    assert (fact.conditions, fact.undecided) == (("data_stamp",), ())
    right = Bench(max_age_s=0.5)
    assert right.each("age_s", [0.1, 0.1]).undecided == ("data_stamp",)
    assert right.each("age_s", [0.1]).undecided == ()


def test_gaps_are_decided_after_enough_intervals() -> None:
    """Also if the counter goes back between them."""
    bench = Bench(counter="seq")
    assert bench.each("counter", [0, 10, 20]).undecided == ("data_gaps",)
    assert bench.each("counter", [0]).undecided == ()
