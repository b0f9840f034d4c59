"""The holds that maintenance windows of the configuration and of container labels begin."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence

from phm.core.maintenance import LABEL, parse
from phm.core.model import Stamp
from phm.core.settings import MaintenanceSettings
from phm.recovery.holds.hold_registry import ALL, WINDOW, Hold, HoldRegistry

CONFIGURED = "maintenance window"
"""Who holds a container while a maintenance window of the configuration is open."""
LABELLED = "maintenance window of its label"


class MaintenanceWindows:
    """note: takes a sentence for the log."""

    def __init__(
        self, windows: Sequence[MaintenanceSettings], holds: HoldRegistry, note: Callable[[str], None]
    ) -> None:
        self._windows, self._holds, self._note = windows, holds, note
        self._reported: set[tuple[str, str]] = set()

    def removed(self) -> list[Hold]:
        """Holds of windows that the configuration does not have any more, or has with another beginning or end."""
        return [hold for hold in self._open() if hold.by == CONFIGURED and not self._configured(hold)]

    def due(self, now: Stamp, labels: Mapping[str, str]) -> Iterator[Hold]:
        """Holds to begin now: of windows that are open and neither held nor released. labels: by container, empty: none."""
        for window in self._windows:
            yield from self._hold(window.container or ALL, window.when, window.reason, CONFIGURED, now)
        for key, when in labels.items():
            if when:
                yield from self._hold(key, when, "", LABELLED, now)

    def _configured(self, hold: Hold) -> bool:
        own = [window for window in self._windows if (window.container or ALL) == hold.target]
        return any(parse(window.when).has(hold.occurrence) for window in own)

    def _hold(self, target: str, when: str, reason: str, by: str, now: Stamp) -> Iterator[Hold]:
        try:
            window = parse(when)
        except ValueError as error:
            self._report(target, f"{target or 'every container'}: the label {LABEL} is not used: {error}")
            return
        found = window.open_at(now.utc)
        if found is None:
            return
        # PHM 0.2.0 kept only the beginning of an occurrence.
        if not {(target, found[0]), (target, found[0].partition("/")[0])}.isdisjoint(self._holds.done()):
            return
        if not any(hold.target == target and hold.occurrence == found[0] for hold in self._open()):
            yield Hold(target, WINDOW, now.mono + min(found[1], window.length_s), by, reason, found[0])

    def _open(self) -> list[Hold]:
        return [hold for hold in self._holds.all() if hold.source == WINDOW]

    def _report(self, target: str, text: str) -> None:
        if (target, text) not in self._reported:
            self._reported.add((target, text))
            self._note(text)
