"""A stream of bytes cut into lines."""

from __future__ import annotations

from phm.probes.ros.protocol import LINE_LIMIT


class Lines:
    """Cuts a stream into lines; one that is longer than the limit is dropped, and memory stays bounded."""

    def __init__(self) -> None:
        self._rest = b""
        self._dropping = False

    def add(self, piece: bytes) -> list[bytes]:
        """The lines that `piece` completes, without their ends."""
        *lines, rest = (self._rest + piece).split(b"\n")
        if lines and self._dropping:
            lines, self._dropping = lines[1:], False
        if self._dropping or len(rest) > LINE_LIMIT:
            rest, self._dropping = b"", True
        self._rest = rest
        return lines
