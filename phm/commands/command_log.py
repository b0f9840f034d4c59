"""Decides which commands are logged individually and which are only counted. Pure; the caller brings time.

Any sender on a link can send ten commands a second that are refused or only read, and log files are rotated. So that they do not
displace everything else, a few of them are logged each minute and the rest is summarized in one line.
"""

from __future__ import annotations

from collections import Counter

from phm.wire.command import Command, CommandResult

PERIOD_S = 60.0
LOGGED_PER_PERIOD = 5
"""Commands a period, of those that any sender can cause."""
MAX_SENDERS, NAMED = 64, 4
"""Senders that are counted individually, and that the summary names: their ids may be forged."""
_OTHERS = "others"


class CommandLog:
    """Logs commands. Not thread-safe."""

    def __init__(self) -> None:
        self._began = self._logged_at = float("-inf")
        self._shown = self._dropped = 0
        self._results: Counter[str] = Counter()
        self._senders: Counter[str] = Counter()

    def should_log(self, command: Command, result: CommandResult, now: float, *, acts: bool) -> bool:
        """Whether this command gets its own line; else it is counted. acts: it approves or restarts."""
        if command.signed or (acts and result is CommandResult.ACCEPTED):
            return True  # signing needs the key, and actions are limited by recovery
        if now - self._began >= PERIOD_S:
            self._began, self._shown = now, 0
        if self._shown < LOGGED_PER_PERIOD:
            self._shown += 1
            return True
        self._results[result.name.lower()] += 1
        sender = f"{command.sender} by {command.link}"
        self._senders[sender if sender in self._senders or len(self._senders) < MAX_SENDERS else _OTHERS] += 1
        return False

    def count_dropped(self) -> None:
        """A command was dropped by the rate limit."""
        self._dropped += 1

    def summary(self, now: float) -> list[str]:
        """Lines about the counted commands, at most once a period."""
        if now - self._logged_at < PERIOD_S or not (self._results or self._dropped):
            return []
        self._logged_at = now
        lines = [self._counted()] if self._results else []
        if self._dropped:
            lines.append(f"{self._dropped} commands dropped: rate limit exceeded")
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
        return f"{total} more commands, not logged individually: {results}; {', '.join(senders)}"
