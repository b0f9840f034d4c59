"""A stream of bytes cut into lines."""

from __future__ import annotations

from phm.probes.ros.protocol import LINE_LIMIT


class LineSplitter:
    """Cuts a stream into lines; one that is longer than the limit is dropped, and memory stays bounded."""

    def __init__(self) -> None:
        self._rest = b""
        self._dropping = False
        self.dropped = 0
        """Number of lines that were longer than the limit."""

    def add(self, piece: bytes) -> list[bytes]:
        """The lines completed by `piece`, without line ends."""
        *lines, rest = (self._rest + piece).split(b"\n")
        if lines and self._dropping:
            lines, self._dropping = lines[1:], False
        kept = [line for line in lines if len(line) <= LINE_LIMIT]
        self.dropped += len(lines) - len(kept)
        if self._dropping or len(rest) > LINE_LIMIT:
            self.dropped += not self._dropping
            rest, self._dropping = b"", True
        self._rest = rest
        return kept
