"""Data of a serial device, which may be any bytes in any pieces."""

from __future__ import annotations

from hypothesis import strategies as st

from phm.probes.serial_ports import MAX_LINE, LineMatcher
from tests.fuzz.targets import fuzzed

PIECES = st.binary(max_size=80) | st.sampled_from([b"\n", b"$GPGGA,1\r\n", b"$GPG", b"\xff" * 3 * MAX_LINE])


@fuzzed("serial lines", pieces=st.lists(PIECES, max_size=12))
def test_a_line_is_found_however_its_bytes_are_cut(pieces: list[bytes]) -> None:
    """If all lines are short enough; nothing but an incomplete line is kept."""
    cut, whole = LineMatcher("$GP*"), LineMatcher("$GP*")
    found = [cut.add(piece) for piece in pieces]
    assert len(cut._rest) <= MAX_LINE
    stream = b"".join(pieces)
    if max(map(len, stream.replace(b"\r", b"\n").split(b"\n"))) <= MAX_LINE:
        assert any(found) == whole.add(stream)
