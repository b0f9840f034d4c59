"""Hostile data: any JSON, a valid document with replaced parts, and bytes that were cut, flipped or repeated."""

from __future__ import annotations

import copy
import json
from typing import Any

from hypothesis import strategies as st

NUMBERS = (
    st.integers(-10, 300)
    | st.sampled_from([2**31, 2**32, 2**53, 2**63 - 1, 2**63, 2**64, -(2**63) - 1, 10**30, 10**400, -1])
    | st.floats()
)
TEXTS = st.text(max_size=20) | st.sampled_from(
    ["", "\0", "\x1b[2J", "\ud800", "a" * 3000, "/", "..", "\n", "é", "\u202e", "0", "-1", "1e999", "NaN", "true"]
)
SCALARS = st.none() | st.booleans() | NUMBERS | TEXTS


def nested(depth: int) -> Any:
    """Lists in lists."""
    made: Any = 0
    for _ in range(depth):
        made = [made]
    return made


JSON = st.recursive(
    SCALARS, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(TEXTS, inner, max_size=4), max_leaves=12
) | st.sampled_from([100, 400, 900]).map(nested)


DEEP = [b"[" * 50_000, *(b'{"Id": ' + b"[" * depth + b"]" * depth + b"}" for depth in range(880, 1000, 4))]
"""Deeper than the reader of JSON goes, and hardly less deep: then what handles the outcome is too deep."""


@st.composite
def damaged(draw: st.DrawFn, document: Any) -> Any:
    """The document with up to four of its parts replaced, removed or duplicated."""
    made = copy.deepcopy(document)
    for _ in range(draw(st.integers(1, 4))):
        if not isinstance(made, (dict, list)) or not made:
            return made
        place = made
        while True:
            keys = list(place) if isinstance(place, dict) else list(range(len(place)))
            key = draw(st.sampled_from(keys))
            inner = place[key]
            if not isinstance(inner, (dict, list)) or not inner or draw(st.integers(0, 3)) == 0:
                break
            place = inner
        _exchange(draw, place, key)
    return made


def _exchange(draw: st.DrawFn, place: Any, key: Any) -> None:
    what = draw(st.sampled_from(["exchange", "exchange", "exchange", "remove", "add"]))
    if what == "exchange":
        place[key] = draw(JSON)
    elif what == "remove":
        del place[key]
    elif isinstance(place, dict):
        place[draw(TEXTS)] = draw(JSON)
    else:
        place.extend(copy.deepcopy(place[key]) for _ in range(draw(st.sampled_from([1, 300]))))


def written(document: Any) -> bytes:
    """As JSON; NaN and infinities stay, as in sloppy writers."""
    try:
        return json.dumps(document).encode("utf-8", "surrogatepass")
    except (RecursionError, ValueError):  # too deep, or a number too long for its digits
        return b"[" * 50_000


@st.composite
def corrupted(draw: st.DrawFn, data: bytes) -> bytes:
    """The bytes with some of them removed, replaced, inserted or repeated."""
    made = bytearray(data)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(made)))
        what = draw(st.sampled_from(["cut", "flip", "put", "repeat", "zero"]))
        if what == "cut":
            del made[at:]
        elif what == "flip" and at < len(made):
            made[at] ^= draw(st.integers(1, 255))
        elif what == "put":
            made[at:at] = draw(st.binary(max_size=40))
        elif what == "repeat":
            made[at:at] = made[at : at + draw(st.integers(1, 200))] * draw(st.sampled_from([1, 2, 50]))
        else:
            made[at : at + 8] = bytes(min(8, len(made) - at))
    return bytes(made)


def messages(document: Any) -> st.SearchStrategy[bytes]:
    """Bytes to be parsed as JSON: this document damaged, any JSON, and this document with damaged bytes."""
    return (
        st.sampled_from(DEEP)
        | damaged(document).map(written)
        | JSON.map(written)
        | corrupted(written(document))
        | st.binary(max_size=200)
    )
