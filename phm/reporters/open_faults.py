"""The open faults as a reporter knows them from events."""

from __future__ import annotations

from collections.abc import Iterable

from phm.core.model import Event, Fault, FaultClosed, FaultOpened

MAX_FAULTS = 256


class OpenFaults(dict[str, Fault]):
    """By id, at most MAX_FAULTS, oldest first. restored: faults that were open before PHM restarted."""

    def __init__(self, restored: Iterable[Fault]) -> None:
        super().__init__({fault.id: fault for fault in restored})

    def take(self, event: Event) -> str:
        """Take an event; the id of the fault that is not listed any more, or empty."""
        gone = ""
        if isinstance(event, FaultOpened):
            self[event.fault.id] = event.fault
            gone = next(iter(self)) if len(self) > MAX_FAULTS else ""
        elif isinstance(event, FaultClosed):
            gone = event.fault.id
        self.pop(gone, None)
        return gone
