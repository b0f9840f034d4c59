"""Executes what an operator requests, whether it came by MAVLink (`mavlink_commands`) or by the control socket (`control_server`)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from phm.commands.requests import AddNote, HoldContainer, OperatorRequest, Ping, ReleaseContainer, Reload, Reply
from phm.commands.services import CommandServices
from phm.core.clock import Clock
from phm.core.model import Fault
from phm.core.rate_limiter import RateLimiter
from phm.wire.command import (
    ApproveAction,
    CommandResult,
    HoldContainerAt,
    PlaceRequest,
    ReleaseContainerAt,
    RestartContainer,
    RunChecks,
    container_hash,
    fault_number,
)

CHECK_EVERY_S = 2.0


class CommandHandler:
    """containers: keys in the order of the configuration. Thread-safe as far as the services are."""

    def __init__(self, services: CommandServices, containers: Sequence[str], clock: Clock) -> None:
        self._services, self._containers, self._clock = services, tuple(containers), clock
        self._checks = RateLimiter(1 / CHECK_EVERY_S, 1.0)

    @property
    def containers(self) -> tuple[str, ...]:
        """Keys of the configured containers; RestartContainer names them by position."""
        return self._containers

    def execute(self, request: OperatorRequest, by: str) -> Reply:
        """by: the operator, for the log. Never raises: what fails is FAILED, with the reason."""
        try:
            return self._execute(request, by)
        except self._services.later as error:
            return Reply(CommandResult.TEMPORARILY_REJECTED, str(error))
        except BaseException as error:  # plug-in code, such as `Action.applies`, may raise even SystemExit
            return Reply(CommandResult.FAILED, str(error) or type(error).__name__)

    def _execute(self, request: OperatorRequest, by: str) -> Reply:
        match request:
            case RunChecks():
                return self._run_checks()
            case ApproveAction(fault):
                return self._approve(fault)
            case RestartContainer() | HoldContainerAt() | ReleaseContainerAt():
                return self._at_place(request, by)
            case HoldContainer(container, for_s, reason):
                return self._hold(container, for_s, reason, by)
            case ReleaseContainer(container):
                return self._release(container, by)
            case AddNote(text):
                self._services.note("NOTE", text)
                return Reply(CommandResult.ACCEPTED, f"noted: {text}")
            case Reload():
                return Reply(CommandResult.ACCEPTED, self._services.reload())
            case Ping():
                return Reply(CommandResult.ACCEPTED, "PHM is running")

    def _run_checks(self) -> Reply:
        if not self._checks.allow(self._clock.mono()):
            return Reply(CommandResult.TEMPORARILY_REJECTED, f"checks were requested less than {CHECK_EVERY_S:g} s ago")
        self._services.run_checks()
        return Reply(CommandResult.ACCEPTED, "running all checks")

    def _approve(self, fault: int | str) -> Reply:
        if isinstance(fault, str):
            return Reply(CommandResult.ACCEPTED, self._services.approve(fault))
        found = numbered(self._services.open_faults(), fault)
        if len(found) != 1:
            return Reply(
                CommandResult.FAILED, f"{'no' if not found else 'more than one'} open fault has number {fault}"
            )
        return Reply(CommandResult.ACCEPTED, self._services.approve(found[0].id))

    def _hold(self, container: str, for_s: float | None, reason: str, by: str) -> Reply:
        text, data = self._services.holds.hold(container, for_s, reason, by)
        return Reply(CommandResult.ACCEPTED, text, data)

    def _release(self, container: str, by: str) -> Reply:
        text, data = self._services.holds.release(container, by)
        return Reply(CommandResult.ACCEPTED, text, data)

    def _at_place(self, request: PlaceRequest, by: str) -> Reply:
        """What is requested of a container by its position. The hash of its name protects against a changed configuration."""
        place, name_hash, count = request.place, request.name_hash, len(self._containers)
        if place > count:
            return Reply(CommandResult.FAILED, f"container {place} does not exist: {count} are configured")
        name = self._containers[place - 1]
        if name_hash not in (0, container_hash(name)):
            return Reply(
                CommandResult.DENIED,
                f"container {place} is {name}, not the chosen one: the configuration has changed, list the containers again",
            )
        match request:
            case HoldContainerAt(for_s=for_s):
                return self._hold(name, for_s, "", by)
            case ReleaseContainerAt():
                return self._release(name, by)
            case _:
                return Reply(CommandResult.ACCEPTED, self._services.restart(name, by))


def numbered(faults: Iterable[Fault], number: int) -> list[Fault]:
    """Those of this number (`phm.wire.command.fault_number`)."""
    return [fault for fault in faults if fault_number(fault.id) == number]
