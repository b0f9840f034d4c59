"""The status word: every level of every slot survives encoding, and nothing else is accepted."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from phm.core.model import Level, Slot
from phm.wire.status_word import VERSION, decode, encode

LEVELS = st.dictionaries(st.sampled_from(Slot), st.sampled_from(Level))


@given(LEVELS)
def test_known_levels_survive_encoding(levels: dict[Slot, Level]) -> None:
    """Decoding returns every known slot; STALE and unused slots are both left out."""
    known = {slot: level for slot, level in levels.items() if level is not Level.STALE}
    assert decode(encode(levels)) == known


@given(LEVELS)
def test_the_word_fits_custom_mode(levels: dict[Slot, Level]) -> None:
    """custom_mode has 32 bits, of which the upper two hold the version."""
    assert 0 <= encode(levels) < 2**32
    assert encode(levels) >> 30 == VERSION


def test_an_all_zero_word_is_not_a_status() -> None:
    """A program that does not set custom_mode is not mistaken for a healthy agent."""
    assert decode(0) == {}


def test_the_layout_is_as_documented() -> None:
    """The example of the module's docstring: bits do not move between versions of the program."""
    levels = {slot: Level.OK for slot in Slot if slot <= 8} | {Slot.NODES: Level.ERROR, Slot.HOST: Level.WARN}
    assert encode(levels) == 0x40025D55


@pytest.mark.parametrize("word", [1, 0x80000000, 0xC0000001, 2**32, -1])
def test_other_versions_are_rejected(word: int) -> None:
    """A word of an unknown layout is rejected with a message instead of misread."""
    with pytest.raises(ValueError, match="status word"):
        decode(word)
