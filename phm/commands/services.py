"""What the desk is given: the way in and out, and what commands may reach."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol

from phm.core.model import Fault, UnitState
from phm.transport.priority import MessagePriority


class MavlinkPort(Protocol):
    """The MAVLink endpoints (`phm.transport.mavlink.MavlinkHub`)."""

    system_id: int
    component_id: int

    @property
    def signs(self) -> bool:
        """Signing is on: only what is signed is obeyed."""

    def send(
        self,
        message: Any,
        kind: MessagePriority = MessagePriority.TRANSITION,
        *,
        key: str = "",
        urgency: int = 0,
        link: str = "",
    ) -> None: ...

    def listen(self, callback: Callable[[Any, str], None], ids: Iterable[int]) -> None: ...


@dataclass(frozen=True)
class CommandServices:
    """What commands may reach; each answers at once, in words or with an exception that says why not.

    complete: whether a first report is done. alive: whether the engine lives.
    approve:  the fault's id. restart: the container's key, and who asks.
    later:    what `approve` and `restart` raise when the same may be command again later.
    remember: called before a signed command that changes something is obeyed, so that it is not obeyed again after a restart
              of PHM; raises OSError when that cannot be made sure.
    clock_problem: why it is not known how old signed commands are, else empty.
    """

    states: Callable[[], tuple[UnitState, ...]]
    open_faults: Callable[[], tuple[Fault, ...]]
    recent_faults: Callable[[], tuple[Fault, ...]]
    complete: Callable[[], bool]
    alive: Callable[[], bool]
    look: Callable[[], None]
    approve: Callable[[str], str]
    restart: Callable[[str, str], str]
    note: Callable[[str, str], None]
    later: type[Exception]
    remember: Callable[[], None] = lambda: None
    clock_problem: Callable[[], str] = lambda: ""
