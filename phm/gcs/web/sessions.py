"""Who is logged in, and who has failed to. Not thread-safe: one event loop. The caller brings time."""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from collections import OrderedDict
from dataclasses import dataclass

from phm.core.rate_limiter import RateLimiter
from phm.gcs.web.options import OPERATE, VIEW, Tokens

IDLE_S = 12 * 3600.0
MAX_SESSIONS = 256
FAILURES, FAILURES_ALL, AGAIN_S = 5, 50, 60.0
"""Wrong tokens of one address, and of all, after which there is one try per AGAIN_S: for the address, and beyond the second for
each that has failed. An address without a wrong one, or with a session, is not kept out by others."""
NETWORK_V6 = 64
"""Bits: one machine has all addresses of such a network."""
MAX_ADDRESSES = 1000


@dataclass(slots=True)
class Session:
    """csrf: to be sent with each change. address: where the session began, as `network` returns it."""

    role: str
    csrf: str
    used: float
    address: str


class Sessions:
    """Holds the sessions and the wrong tokens of each address. tokens: None where no login is needed."""

    def __init__(self, tokens: Tokens | None) -> None:
        self.tokens = tokens
        self._sessions: OrderedDict[str, Session] = OrderedDict()
        self._failures = RateLimiter(1 / AGAIN_S, FAILURES, MAX_ADDRESSES)
        self._failures_all = RateLimiter(1 / AGAIN_S, FAILURES_ALL)

    def begin(self, role: str, now: float, address: str) -> tuple[str, Session]:
        """Begin a session; return its secret and the session."""
        key = secrets.token_urlsafe(32)
        session = Session(role, secrets.token_urlsafe(32), now, network(address))
        self._sessions[key] = session
        while len(self._sessions) > MAX_SESSIONS:
            self._sessions.popitem(last=False)
        return key, session

    def find(self, key: str, now: float) -> Session | None:
        session = self._sessions.get(key)
        if session is None:
            return None
        if now - session.used > IDLE_S:
            del self._sessions[key]
            return None
        session.used = now
        self._sessions.move_to_end(key)
        return session

    def end(self, key: str) -> None:
        self._sessions.pop(key, None)

    def role_of(self, token: str) -> str:
        """The role of a token, empty for a wrong one. Takes the same time for every token."""
        if self.tokens is None:
            return ""
        said = token.encode("utf-8", "surrogatepass")  # JSON can hold half of a surrogate pair: a wrong token
        operate = _equal(said, self.tokens.operate)
        view = _equal(said, self.tokens.view)
        return OPERATE if operate else VIEW if view else ""

    def blocked(self, address: str, now: float) -> bool:
        """Whether there were too many wrong tokens from this address, or one and too many from all together."""
        address = network(address)
        left = self._failures.left(now, address)
        if left < 1 or left >= FAILURES:
            return left < 1
        return self._failures_all.left(now) < 1 and not self._known(address, now)

    def _known(self, address: str, now: float) -> bool:
        """Whether a session exists for this address."""
        return any(each.address == address and now - each.used <= IDLE_S for each in self._sessions.values())

    def failed(self, address: str, now: float) -> None:
        self._failures.allow(now, network(address))
        self._failures_all.allow(now)


def network(address: str) -> str:
    """The network of an address, for which its wrong tokens are counted."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if found.version == 4:
        return str(found)
    if found.ipv4_mapped is not None:
        return str(found.ipv4_mapped)
    return str(ipaddress.ip_network((found.packed, NETWORK_V6), strict=False))


def _equal(said: bytes, token: str) -> bool:
    """Whether both are equal, in constant time; an empty token equals nothing."""
    return hmac.compare_digest(said, token.encode("ascii")) and bool(token)
