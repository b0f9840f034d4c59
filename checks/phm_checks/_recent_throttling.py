"""Why a Raspberry Pi was throttled in the last seconds.

Not a check: files in this folder whose names start with an underscore are parts of checks.
"""

from __future__ import annotations

from collections.abc import Sequence


class RecentThrottling:
    """Keeps each reason for `report_s` after it last applied.

    `earlier` in PHM's first reading may be as old as the boot. In later ones it counts when it appears. A kernel that was seen to
    clear a reason sets it again only for new throttling: then it counts in each reading.
    """

    def __init__(self, report_s: float) -> None:
        self._report_s = report_s
        self._before: frozenset[str] | None = None
        self._clears = False
        self._seen: dict[str, float] = {}

    def observe(self, flags: Sequence[str] | None, now: float) -> list[str]:
        """The reasons of the last `report_s`; `flags` as in `phm.api.HostFact.throttled`."""
        if flags is not None:
            self._read(flags, now)
        return [reason for reason, at in self._seen.items() if now - at < self._report_s]

    def _read(self, flags: Sequence[str], now: float) -> None:
        reasons = frozenset(flag.rpartition(" ")[0] for flag in flags)
        before = reasons if self._before is None else self._before
        self._clears = self._clears or not before <= reasons
        for flag in flags:
            reason, _, when = flag.rpartition(" ")
            if when == "now" or self._clears or reason not in before:
                self._seen[reason] = now
        self._before = reasons
