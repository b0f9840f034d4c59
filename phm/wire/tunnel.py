"""What agents send each other and the ground in MAVLink TUNNEL messages: views, digests, fault details.

Layout of a payload, at most 128 bytes; numbers are unsigned and little-endian. TUNNEL's own fields stay free:
``target_system`` 0 for all, ``payload_type`` is ``PAYLOAD_TYPE``, of the range for private use::

    byte  0       version (high 4 bits, now 1), kind (low 4 bits)

    kind 1, VIEW: how one agent sees the others
    byte  1       sequence, counts up by one a view, modulo 256
    byte  2       flags: bit 0 receives a ground station, bit 1 receives its autopilot, bit 2 its radio reports
    byte  3       first agent id
    byte  4...    2 bits an agent, lowest first: 0 never seen, 1 alive, 2 late, 3 lost

    kind 2, DIGEST: the status of the swarm, by the elected leader
    byte  1       agents that count as members
    byte  2       agents of these that are alive
    byte  3       first agent id
    byte  4...    2 bits an agent, lowest first: 0 not known, 1 OK, 2 WARN, 3 ERROR

    kind 3, WORDS: status words as the sender received them
    byte  1       first agent id
    byte  2...    4 bytes an agent: its status word, 0 not known

    kind 4, DETAIL: text about one fault, on request, in parts
    byte  1       part, from 0
    byte  2       parts
    byte  3       length n of the fault's id
    byte  4...    the id, n bytes of ASCII, then a piece of the text in UTF-8 (a character may be cut between parts)

Trailing zero bytes carry no meaning: MAVLink 2 cuts them, and a reader adds what it lacks. Pure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import chain

from phm.core.model import Level

PAYLOAD_TYPE = 46_193
"""In 32768 to 65535, which MAV_TUNNEL_PAYLOAD_TYPE leaves to private use."""
MAX_BYTES = 128
MAX_WORDS = (MAX_BYTES - 2) // 4
VERSION = 1
AGENTS = range(1, 251)
MAX_PARTS = 16
"""Of a DETAIL: about 1.7 kB of text, more than any fault has to say."""

_LEVELS = (Level.STALE, Level.OK, Level.WARN, Level.ERROR)
_CODES = [(byte & 3, byte >> 2 & 3, byte >> 4 & 3, byte >> 6) for byte in range(256)]
"""The codes of four agents, by the byte that holds them."""


class TunnelError(ValueError):
    """A payload that does not follow this contract; the message says why."""


class PeerState(IntEnum):
    """How an agent sees a peer."""

    NEVER = 0
    ALIVE = 1
    LATE = 2
    LOST = 3


_STATES = tuple(PeerState)


@dataclass(frozen=True, slots=True)
class PeerView:
    """`peers` by agent id; those left out were never seen."""

    sequence: int
    gcs: bool
    autopilot: bool
    radio: bool
    peers: Mapping[int, PeerState] = field(default_factory=dict)
    there: frozenset[int] = field(init=False, compare=False, repr=False)
    """Those that the sender receives: alive or late."""

    def __post_init__(self) -> None:
        there = frozenset(agent for agent, seen in self.peers.items() if seen in (PeerState.ALIVE, PeerState.LATE))
        object.__setattr__(self, "there", there)


@dataclass(frozen=True, slots=True)
class SwarmDigest:
    """`levels` by agent id, the worst of each; STALE for not known, as are those left out."""

    members: int
    alive: int
    levels: Mapping[int, Level] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class StatusWords:
    """Status words by agent id, see `phm.wire.status_word`."""

    words: Mapping[int, int] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class FaultDetail:
    """One part of the text about a fault."""

    fault: str
    part: int
    parts: int
    text: bytes


TunnelMessage = PeerView | SwarmDigest | StatusWords | FaultDetail
_VIEW, _DIGEST, _WORDS, _DETAIL = 1, 2, 3, 4


def encode(message: TunnelMessage) -> bytes:
    """The payload. Raises ValueError for agent ids outside of 1 to 250 and for what does not fit."""
    if isinstance(message, PeerView):
        flags = message.gcs | message.autopilot << 1 | message.radio << 2
        first, bits = _pack_bits({agent: int(seen) for agent, seen in message.peers.items()})
        body = bytes((_head(_VIEW), message.sequence % 256, flags, first)) + bits
    elif isinstance(message, SwarmDigest):
        first, bits = _pack_bits({agent: _LEVELS.index(level) for agent, level in message.levels.items()})
        body = bytes((_head(_DIGEST), _byte(message.members), _byte(message.alive), first)) + bits
    elif isinstance(message, StatusWords):
        body = _pack_words(message.words)
    else:
        name = message.fault.encode("ascii")
        body = (
            bytes((_head(_DETAIL), _byte(message.part), _byte(message.parts), _byte(len(name)))) + name + message.text
        )
    if len(body) > MAX_BYTES:
        raise ValueError(f"{len(body)} bytes do not fit into a tunnel of {MAX_BYTES}")
    return body


def decode(payload: bytes) -> TunnelMessage:
    """What `encode` wrote. Raises TunnelError for everything else; nothing in it is trusted."""
    if not 0 < len(payload) <= MAX_BYTES:
        raise TunnelError(f"a payload has 1 to {MAX_BYTES} bytes, not {len(payload)}")
    version, kind = payload[0] >> 4, payload[0] & 15
    if version != VERSION:
        raise TunnelError(f"version {version}; this program reads version {VERSION}")
    readers: Mapping[int, Callable[[bytes], TunnelMessage]] = {
        _VIEW: _view,
        _DIGEST: _digest,
        _WORDS: _words,
        _DETAIL: _detail,
    }
    reader = readers.get(kind)
    if reader is None:
        raise TunnelError(f"unknown kind {kind}")
    return reader(payload)


def details(fault: str, text: str) -> list[FaultDetail]:
    """The text about a fault in as many parts as it takes, at most MAX_PARTS; the rest is cut."""
    room = MAX_BYTES - 4 - len(fault.encode("ascii"))
    data = text.encode()[: room * MAX_PARTS]
    pieces = [data[at : at + room] for at in range(0, len(data), room)] or [b""]
    return [FaultDetail(fault, part, len(pieces), piece) for part, piece in enumerate(pieces)]


def _head(kind: int) -> int:
    return VERSION << 4 | kind


def _byte(value: int) -> int:
    if not 0 <= value <= 255:
        raise ValueError(f"{value} does not fit into a byte")
    return value


def _range(agents: Mapping[int, int]) -> tuple[int, int]:
    """First agent id and how many there are up to the last."""
    if not agents:
        return 1, 0
    first, last = min(agents), max(agents)
    if first not in AGENTS or last not in AGENTS:
        raise ValueError(f"agent ids are 1 to 250, not {first if first not in AGENTS else last}")
    return first, last - first + 1


def _pack_bits(codes: Mapping[int, int]) -> tuple[int, bytes]:
    first, count = _range(codes)
    whole = 0
    for agent, code in codes.items():
        whole |= code << 2 * (agent - first)
    return first, whole.to_bytes((count + 3) // 4, "little")


def _bits(payload: bytes, at: int) -> dict[int, int]:
    codes = chain.from_iterable(_CODES[byte] for byte in payload[at + 1 :])
    said = {agent: code for agent, code in enumerate(codes, _first(payload, at)) if code}
    if said and max(said) not in AGENTS:
        raise TunnelError(f"it names agent {max(said)}; ids are 1 to 250")
    return said


def _first(payload: bytes, at: int) -> int:
    first = payload[at] if len(payload) > at else 0
    if first not in AGENTS:
        raise TunnelError(f"it begins with agent {first}; ids are 1 to 250")
    return first


def _pack_words(words: Mapping[int, int]) -> bytes:
    first, count = _range(words)
    if count > MAX_WORDS:
        raise ValueError(f"at most {MAX_WORDS} neighbouring agents fit into one message, not {count}")
    return bytes((_head(_WORDS), first)) + b"".join(
        words.get(agent, 0).to_bytes(4, "little") for agent in range(first, first + count)
    )


def _view(payload: bytes) -> PeerView:
    filled = payload.ljust(4, b"\0")
    flags, codes = filled[2], _bits(filled, 3)
    peers = {agent: _STATES[code] for agent, code in codes.items()}
    return PeerView(filled[1], bool(flags & 1), bool(flags & 2), bool(flags & 4), peers)


def _digest(payload: bytes) -> SwarmDigest:
    filled = payload.ljust(4, b"\0")
    if filled[2] > filled[1]:
        raise TunnelError(f"{filled[2]} agents of {filled[1]} are alive")
    return SwarmDigest(filled[1], filled[2], {agent: _LEVELS[code] for agent, code in _bits(filled, 3).items()})


def _words(payload: bytes) -> StatusWords:
    first = _first(payload, 1)
    body = payload[2:]
    body += bytes(-len(body) % 4)
    words = {first + i: int.from_bytes(body[4 * i : 4 * i + 4], "little") for i in range(len(body) // 4)}
    said = {agent: word for agent, word in words.items() if word}
    if said and max(said) not in AGENTS:
        raise TunnelError(f"it names agent {max(said)}; ids are 1 to 250")
    return StatusWords(said)


def _detail(payload: bytes) -> FaultDetail:
    filled = payload.ljust(4, b"\0")
    part, parts, length = filled[1], filled[2], filled[3]
    if not part < parts <= MAX_PARTS:
        raise TunnelError(f"part {part} of {parts}; there are 1 to {MAX_PARTS}")
    name, text = filled[4 : 4 + length], filled[4 + length :]
    if len(name) < length or not name.isascii() or not name.decode("ascii").isprintable():
        raise TunnelError("the fault's id is not printable ASCII of its length")
    return FaultDetail(name.decode("ascii"), part, parts, text)
