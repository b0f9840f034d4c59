"""Type `tcp`: a TCP server accepts connections."""

from __future__ import annotations

from phm import api
from phm_checks._custom.base import CustomCheck, Finding, bad, good


class Tcp(CustomCheck):
    """Connects, and compares what the server sends first."""

    def observe(self, world: api.World) -> Finding:
        entry = self.entry
        where = f"{entry.host} port {entry.port}"
        wanted = entry.expect or ""
        fact = world.sockets.connect(entry.host, entry.port, timeout_s=entry.timeout, expect=wanted)
        took_s = round(fact.took_s, 3)
        if fact.problem:
            return bad(f"{where}: {fact.problem}, expected a connection", "no connection", took_s=took_s)
        if wanted not in fact.received:
            sent = f"sent {fact.received[:80]!r}" if fact.received else "sent nothing"
            return bad(f"{where} {sent}, expected {wanted!r}", "wrong answer", took_s=took_s)
        return good(f"{where} is connected", took_s=took_s)
