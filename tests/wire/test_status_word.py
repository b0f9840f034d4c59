"""The status word: every level of every slot survives encoding, and nothing else is accepted."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from phm.core.model import Level, Slot
from phm.wire.status_word import VERSION, decode, encode

LEVELS = st.dictionaries(st.sampled_from(Slot), st.sampled_from(Level))


@given(LEVELS)
def test_what_is_known_survives_the_journey(levels: dict[Slot, Level]) -> None:
    """Decoding gives back every slot that was known; STALE and unused are the same: left out."""
    known = {slot: level for slot, level in levels.items() if level is not Level.STALE}
    assert decode(encode(levels)) == known


@given(LEVELS)
def test_the_word_fits_the_field(levels: dict[Slot, Level]) -> None:
    """custom_mode has 32 bits, of which the upper two hold the version."""
    assert 0 <= encode(levels) < 2**32
    assert encode(levels) >> 30 == VERSION


def test_an_all_zero_word_claims_nothing() -> None:
    """A program that leaves custom_mode alone is not taken for a healthy agent."""
    assert decode(0) == {}


def test_the_layout_is_as_documented() -> None:
    """The example of the module's text: bits do not move between versions of the program."""
    levels = {slot: Level.OK for slot in Slot if slot <= 8} | {Slot.NODES: Level.ERROR, Slot.HOST: Level.WARN}
    assert encode(levels) == 0x40025D55


@pytest.mark.parametrize("word", [1, 0x80000000, 0xC0000001, 2**32, -1])
def test_other_versions_are_refused(word: int) -> None:
    """A word of a layout that is not known is refused with a sentence instead of read wrongly."""
    with pytest.raises(ValueError, match="status word"):
        decode(word)
