"""Which peers a listening endpoint keeps when there are too many. Pure; the caller brings time.

Any host on the network can use many source ports or open many connections. So one address has at most half of the places.
An idle peer makes room for a new one, and so does a peer of the address that has the most. An active peer that is the only one
of its address is replaced only by one that signs. With signing on, some places are reserved for peers that sign.
"""

from __future__ import annotations

import ipaddress
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from operator import itemgetter
from typing import Any

MAX_PEERS = 16
PER_ADDRESS = 8
"""Peers of one address that do not sign; half, so that one host leaves room for others."""
RESERVED = 4
"""Places for peers that sign, where signing is on."""
IDLE_S = 3.0
"""After this silence a peer may be replaced. Ground stations and autopilots send a HEARTBEAT each second."""
PROVE_S = 5.0
"""Time within which a connection in a reserved place must send a signed frame."""


@dataclass(slots=True)
class _Peer:
    address: str
    since: float
    heard: float
    signed: bool


class ClientAdmission:
    """The peers of one endpoint, by any key. Not thread-safe.

    Invariant: at most MAX_PEERS, of which at most PER_ADDRESS of one address do not sign.
    """

    def __init__(self, *, signs: bool, on_trial: bool = False) -> None:
        """signs: signing is on. on_trial: a peer is admitted before it can sign (a connection), so it may use a reserved
        place for PROVE_S; else what it has sent counts (a datagram)."""
        self._open = MAX_PEERS - RESERVED if signs else MAX_PEERS
        self._on_trial = on_trial
        self._peers: dict[Any, _Peer] = {}

    def __contains__(self, key: Any) -> bool:
        return key in self._peers

    @property
    def peers(self) -> list[Any]:
        return list(self._peers)

    def admit(self, key: Any, host: str, now: float, *, signed: bool = False) -> list[Any] | None:
        """The peers to disconnect so that this new one is admitted; None: it is refused. host: its IP address."""
        address = _address(host)
        going = self._victims(address, now, signed)
        if going is None:
            return None
        for victim in going:
            del self._peers[victim]
        self._peers[key] = _Peer(address, now, now, signed)
        return going

    def heard(self, key: Any, now: float, *, signed: bool) -> None:
        """A peer sent something. signed: with a valid signature."""
        peer = self._peers[key]
        peer.heard, peer.signed = now, peer.signed or signed

    def forget(self, key: Any) -> None:
        self._peers.pop(key, None)

    def expire(self, now: float, silent_s: float) -> None:
        """Forget peers that were silent for `silent_s`."""
        self._peers = {key: peer for key, peer in self._peers.items() if now - peer.heard <= silent_s}

    def unproven(self, now: float) -> list[Any]:
        """Peers that used a reserved place for too long without signing."""
        return [key for key in self._trial() if now - self._peers[key].since > PROVE_S]

    def _victims(self, address: str, now: float, signed: bool) -> list[Any] | None:
        unsigned = self._unsigned()
        if signed:
            if len(self._peers) < MAX_PEERS:
                return []
            return self._oldest(unsigned, now, 0.0) or self._oldest(self._peers, now, IDLE_S)
        neighbours = [key for key in unsigned if self._peers[key].address == address]
        if len(neighbours) >= PER_ADDRESS:
            return self._oldest(neighbours, now, IDLE_S)
        if len(self._peers) < MAX_PEERS and (len(unsigned) < self._open or self._on_trial):
            return []
        return self._oldest(unsigned, now, IDLE_S) or self._of_a_crowd(unsigned, len(neighbours))

    def _unsigned(self) -> list[Any]:
        """In the order in which they came."""
        return [key for key, peer in self._peers.items() if not peer.signed]

    def _trial(self) -> list[Any]:
        """Those in reserved places that have not signed so far, oldest first."""
        return self._unsigned()[self._open :]

    def _of_a_crowd(self, keys: list[Any], fewer: int) -> list[Any] | None:
        """The newest of the address that has most of these, if that has more than the new peer's address will have."""
        counts = Counter(self._peers[key].address for key in keys)
        address, most = max(counts.items(), key=itemgetter(1), default=("", 0))
        if most < fewer + 2:
            return None
        return [next(key for key in reversed(keys) if self._peers[key].address == address)]

    def _oldest(self, keys: Iterable[Any], now: float, silent_s: float) -> list[Any] | None:
        """The one of these that was silent for longest, if that is so long."""
        key = min(keys, key=lambda each: self._peers[each].heard, default=None)
        return None if key is None or now - self._peers[key].heard < silent_s else [key]


def _address(host: str) -> str:
    """What one host has one of: an IPv4 address, or a network of IPv6, in which it may take any."""
    address = ipaddress.ip_address(host.partition("%")[0])
    if isinstance(address, ipaddress.IPv6Address) and address.ipv4_mapped is None:
        return str(ipaddress.ip_network((address, 64), strict=False))
    return str(address)
