"""Which commands are logged one by one, and which are counted. Pure; the caller brings time.

Anybody on a link can send commands that are refused or that only read, ten a second, and the log is a ring: what else is in
it must outlive them. So of these a few a minute are logged, and the rest becomes one line.
"""

from __future__ import annotations

from collections import Counter

from phm.wire.command import Command, CommandResult

PERIOD_S = 60.0
LOGGED_PER_PERIOD = 5
"""In each period, of those that anybody can cause."""
MAX_SENDERS, NAMED = 64, 4
"""Senders that are counted one by one, and that the line names: they can make up their numbers."""
_OTHERS = "others"


class CommandLog:
    """Not thread-safe."""

    def __init__(self) -> None:
        self._began = self._logged_at = float("-inf")
        self._shown = self._dropped = 0
        self._results: Counter[str] = Counter()
        self._senders: Counter[str] = Counter()

    def logs(self, command: Command, result: CommandResult, now: float, *, acts: bool) -> bool:
        """Whether this command has a line of its own; else it is counted. acts: what was asked for does more than read or check."""
        if command.signed or (acts and result is CommandResult.ACCEPTED):
            return True  # only who has the key can sign, and what acts is bounded by recovery
        if now - self._began >= PERIOD_S:
            self._began, self._shown = now, 0
        if self._shown < LOGGED_PER_PERIOD:
            self._shown += 1
            return True
        self._results[result.name.lower()] += 1
        sender = f"{command.sender} by {command.link}"
        self._senders[sender if sender in self._senders or len(self._senders) < MAX_SENDERS else _OTHERS] += 1
        return False

    def dropped(self) -> None:
        """One was dropped unread."""
        self._dropped += 1

    def due(self, now: float) -> list[str]:
        """Lines about what was counted, at most once a period."""
        if now - self._logged_at < PERIOD_S or not (self._results or self._dropped):
            return []
        self._logged_at = now
        lines = [self._counted()] if self._results else []
        if self._dropped:
            lines.append(f"{self._dropped} commands were dropped unread: too many came at once")
        self._dropped = 0
        self._results.clear()
        self._senders.clear()
        return lines

    def _counted(self) -> str:
        total = self._results.total()
        results = ", ".join(f"{count} {name}" for name, count in self._results.most_common())
        top = [(sender, count) for sender, count in self._senders.most_common(NAMED) if sender != _OTHERS]
        senders = [f"{count} from {sender}" for sender, count in top]
        if rest := total - sum(count for _sender, count in top):
            senders.append(f"{rest} from {_OTHERS}")
        return f"{total} more commands, not logged one by one: {results}; {', '.join(senders)}"
