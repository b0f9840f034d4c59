"""What the commands are given: the MAVLink endpoints, and the functions that requests may call."""

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
        """Signing is on: only signed commands are accepted."""

    @property
    def agents(self) -> int:
        """How many agents share the links, this one included."""

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


class HoldController(Protocol):
    """Begins and ends holds (`phm.recovery.holds.hold_service.HoldService`): a sentence and data, or an exception with the reason."""

    def hold(self, container: str, for_s: float | None, reason: str, by: str) -> tuple[str, dict[str, Any]]: ...

    def release(self, container: str, by: str) -> tuple[str, dict[str, Any]]: ...


class NoHolds:
    """Used where there is no recovery."""

    def hold(self, container: str, for_s: float | None, reason: str, by: str) -> tuple[str, dict[str, Any]]:
        raise LookupError("holds are not available")

    def release(self, container: str, by: str) -> tuple[str, dict[str, Any]]:
        raise LookupError("holds are not available")


NO_HOLDS = NoHolds()


def no_reload() -> str:
    """Used where nothing can be reloaded."""
    raise LookupError("the configuration cannot be reloaded")


@dataclass(frozen=True)
class CommandServices:
    """What a request may read and do. Each returns immediately, with a sentence or an exception that says why not.

    complete: whether a first report is done. alive: whether main loop and checks run.
    approve:  by the fault's id. restart: the container's key, and who requests it.
    later:    what `approve` and `restart` raise when the same request may succeed later.
    remember: called before a signed command changes something, so that a replay of it is refused after a restart of PHM;
              raises OSError when it cannot be stored, TimeoutError when that takes too long.
    clock_problem: why the age of signed commands is unknown, else empty.
    """

    states: Callable[[], tuple[UnitState, ...]]
    open_faults: Callable[[], tuple[Fault, ...]]
    recent_faults: Callable[[], tuple[Fault, ...]]
    complete: Callable[[], bool]
    alive: Callable[[], bool]
    run_checks: Callable[[], None]
    approve: Callable[[str], str]
    restart: Callable[[str, str], str]
    note: Callable[[str, str], None]
    later: type[Exception]
    remember: Callable[[], None] = lambda: None
    clock_problem: Callable[[], str] = lambda: ""
    holds: HoldController = NO_HOLDS
    reload: Callable[[], str] = no_reload
