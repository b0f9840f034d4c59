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
"""Maximum number of unsigned peers of one address: half, so that one host leaves places for others."""
RESERVED = 4
"""Places reserved for peers that sign, with signing on."""
IDLE_S = 3.0
"""After this silence a peer may be replaced. Ground stations and autopilots send a HEARTBEAT each second."""
PROVE_S = 5.0
"""Time within which a connection in a reserved place must send a signed frame."""


@dataclass(slots=True)
class _Peer:
    address: str
    since: float
    received: float
    signed: bool


class ClientAdmission:
    """The peers of one endpoint, by any key. Not thread-safe.

    Invariant: at most MAX_PEERS, of which at most PER_ADDRESS unsigned ones have the same address.
    """

    def __init__(self, *, signs: bool, on_trial: bool = False) -> None:
        """signs: signing is on. on_trial: a peer is admitted before it can sign (a connection), so it may use a
        reserved place for PROVE_S; otherwise its first frame decides (a datagram)."""
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

    def receive(self, key: Any, now: float, *, signed: bool) -> None:
        """A peer sent data. signed: with a valid signature."""
        peer = self._peers[key]
        peer.received, peer.signed = now, peer.signed or signed

    def forget(self, key: Any) -> None:
        self._peers.pop(key, None)

    def expire(self, now: float, silent_s: float) -> None:
        """Forget peers that were silent for `silent_s`."""
        self._peers = {key: peer for key, peer in self._peers.items() if now - peer.received <= silent_s}

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
        """The peers in the order of their admission."""
        return [key for key, peer in self._peers.items() if not peer.signed]

    def _trial(self) -> list[Any]:
        """Peers in reserved places that have not signed so far, oldest first."""
        return self._unsigned()[self._open :]

    def _of_a_crowd(self, keys: list[Any], fewer: int) -> list[Any] | None:
        """The newest of the address that has most of these, if that has more than the new peer's address would have."""
        counts = Counter(self._peers[key].address for key in keys)
        address, most = max(counts.items(), key=itemgetter(1), default=("", 0))
        if most < fewer + 2:
            return None
        return [next(key for key in reversed(keys) if self._peers[key].address == address)]

    def _oldest(self, keys: Iterable[Any], now: float, silent_s: float) -> list[Any] | None:
        """The one of these that has been silent longest, if for at least the minimum time."""
        key = min(keys, key=lambda each: self._peers[each].received, default=None)
        return None if key is None or now - self._peers[key].received < silent_s else [key]


def _address(host: str) -> str:
    """The identity of a host: an IPv4 address, or an IPv6 network, in which it may use any address."""
    address = ipaddress.ip_address(host.partition("%")[0])
    if isinstance(address, ipaddress.IPv6Address) and address.ipv4_mapped is None:
        return str(ipaddress.ip_network((address, 64), strict=False))
    return str(address)
