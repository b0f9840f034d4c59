"""Parses and validates the text of a beacon (`phm.beacon`), which comes from outside and may contain anything."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Iterator, Mapping
from typing import Any

from phm.beacon import MAX_LATE_S, MAX_NAME, MAX_NEIGHBOURS, MAX_NODES, MAX_TEXT, NAME, PERIODS_S
from phm.facts.ros import BeaconFact, NeighbourFact

MAX_WORD = 60
MAX_AGE_S = 1e6
_ENDIAN = {b"\0\0": ">", b"\0\1": "<"}
_BEHIND_LEVEL = 13


def log_texts(data: bytes) -> tuple[str, str]:
    """`name` and `msg` of a serialized rcl_interfaces/msg/Log; creating a message object per heartbeat took a tenth of
    the child's CPU time.

    CDR: 4 bytes of header, the stamp in 8, the level in 1; then each text at a multiple of 4, with its length and a
    final zero. Raises ValueError or struct.error for anything else.
    """
    if data[:2] not in _ENDIAN:
        raise ValueError("not plain CDR")
    length = struct.Struct(f"{_ENDIAN[data[:2]]}I")
    texts, at = [], _BEHIND_LEVEL
    for _ in range(2):
        at += -at % 4
        (size,) = length.unpack_from(data, at)
        end = at + length.size + size
        if not size or end > len(data) or data[end - 1]:
            raise ValueError("a text that is cut")
        texts.append(data[at + length.size : end - 1].decode("utf-8"))
        at = end
    return texts[0], texts[1]


def beacons_in(text: str) -> Iterator[tuple[str, BeaconFact, bool]]:
    """The nodes of one message: full name, fact (age 0), and whether it lists neighbours.

    Raises ValueError, TypeError, KeyError, AttributeError, OverflowError or RecursionError for anything else.
    """
    if len(text) > MAX_TEXT:
        raise ValueError("too long")
    said = json.loads(text)
    witness, period_s = _word(said["witness"]), _number(said["period_s"], *PERIODS_S)
    nodes, seen = said["nodes"], said.get("views")
    if not nodes or len(nodes) > MAX_NODES or len(seen or ()) > MAX_NEIGHBOURS:
        raise ValueError("no elements, or too many")
    views = {_name(name): _view(view) for name, view in seen.items()} if seen else {}
    facts = []
    for name, node in nodes.items():
        fact = BeaconFact(
            age_s=0.0,
            period_s=period_s,
            late_s=_number(node["late_s"], 0.0, MAX_LATE_S),
            birth=_word(node["birth"]),
            heartbeats=_count(node["beats"]),
            views=views,
            turns=_count(node["turns"]),
            witness=witness,
            full=len(views) >= MAX_NEIGHBOURS,
        )
        facts.append((_name(name), fact, seen is not None))
    return iter(facts)


def _view(view: Mapping[str, Any]) -> NeighbourFact:
    alive = view["alive"]
    if not isinstance(alive, bool):
        raise TypeError("alive is neither true nor false")
    return NeighbourFact(alive, _number(view["age_s"], 0.0, MAX_AGE_S), _number(view["late_s"], 0.0, MAX_LATE_S))


def _name(name: object) -> str:
    if not isinstance(name, str) or len(name) > MAX_NAME or not NAME.fullmatch(name):
        raise ValueError("not the full name of a node")
    return name


def _word(word: object) -> str:
    if not isinstance(word, str) or not word.isprintable() or not 0 < len(word) <= MAX_WORD:
        raise ValueError("not a word")
    return word


def _number(number: object, least: float, most: float) -> float:
    if isinstance(number, bool) or not isinstance(number, (int, float)) or not math.isfinite(number):
        raise TypeError("not a number")
    if not least <= number <= most:
        raise ValueError("an impossible number")
    return float(number)


def _count(number: object) -> int:
    if type(number) is not int or not 0 <= number < 2**63:
        raise TypeError("not a count")
    return number
