"""Section `recovery`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema

from phm.core.maintenance import parse as parse_window
from phm.core.settings.base import Name, Seconds, Section


class ManualStopSettings(Section):
    """How to treat a stop or a pause by an operator (`docker stop`, `docker pause`, `docker compose stop`, `down`)."""

    ground: Literal["heal", "advise", "respect"] = "respect"
    """While the autopilot reports that it is disarmed."""
    air: Literal["heal", "advise", "respect"] = "heal"
    """While it is armed, or its armed state is not known."""


def _for_both(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    if value not in _RULE["enum"]:
        raise ValueError(
            f"{value[:60]!r} is not a rule: allowed are heal, advise and respect, or one each for ground and air"
        )
    return {"ground": value, "air": value}


_RULE: dict[str, Any] = {"enum": ["heal", "advise", "respect"], "type": "string"}


ManualStop = Annotated[
    ManualStopSettings,
    BeforeValidator(_for_both),
    WithJsonSchema(
        {
            "anyOf": [
                _RULE,
                {"type": "object", "properties": {"ground": _RULE, "air": _RULE}, "additionalProperties": False},
            ]
        }
    ),
]


def _window(value: str) -> str:
    parse_window(value)
    return value


class MaintenanceSettings(Section):
    """A time in which a container, or all, is on hold; not while the autopilot is armed."""

    when: Annotated[str, AfterValidator(_window)]
    """`[DAYS or DATE] HH:MM-HH:MM` in UTC, e.g. `sun 02:00-04:00`, `mon-fri 12:00-12:30`, `2026-11-22 22:00-01:00`."""
    container: Name | None = None
    """Key of the container; default: all."""
    reason: Annotated[str, Field(max_length=200)] = ""
    """Shown with the hold."""


class RecoverySettings(Section):
    """What PHM may do about faults. Only containers with `recover: true` are ever touched."""

    mode: Literal["act", "advise", "off"] = "act"
    """`act`: take actions; `advise`: only recommend them; `off`: neither. PHM joins networks itself in any mode."""
    backoff: Annotated[Seconds, Field(gt=0)] = 1.0
    """Seconds before the second attempt; doubled for each further one."""
    backoff_max: Annotated[Seconds, Field(gt=0)] = 60.0
    """Longest wait between attempts."""
    budget: Annotated[int, Field(ge=1, le=100)] = 5
    """Most actions on one container within `window`."""
    reserve: Annotated[int, Field(ge=0, le=99)] = 1
    """How many of them are reserved for a container that is down. Beyond the budget, such a container is still started, but only
    once per `backoff_max`."""
    window: Annotated[Seconds, Field(ge=1)] = 600.0
    """Seconds over which the budget counts."""
    same_failure: Annotated[int, Field(ge=1, le=100)] = 3
    """After the same failure this many times: give up, report it, and leave it to the operator."""
    verify: Annotated[Seconds, Field(ge=1)] = 30.0
    """Seconds within which the check must be OK again after an action; else the action has failed. It has failed sooner if the check
    still finds an error 2 s after its grace, which is `ros.grace` for nodes and topics."""
    stop_timeout: Annotated[Seconds, Field(ge=0, le=300)] = 5.0
    """Seconds between the stop signal and SIGKILL when PHM restarts a container. A container that asks for more time itself
    (`stop_grace_period` in Compose) gets it, up to 2 min."""
    patience: Annotated[Seconds, Field(ge=0, le=600)] = 10.0
    """Seconds for which a topic must have been silent or slow, lost a publisher or subscriber or had incompatible ones while its
    nodes are alive, or a node must have been duplicate, before an action is taken."""
    patience_min: Annotated[Seconds, Field(ge=0, le=600)] = 2.0
    """What `patience` shrinks to, or twice the topic's longest pause if that is more, once the topic has been OK for `verify`
    since its container started. The same as `patience`: it does not shrink."""
    approval: Annotated[Seconds, Field(ge=5, le=600)] = 60.0
    """Seconds for which an approval is valid; after that the action must be approved again."""
    on_manual_stop: ManualStop = ManualStopSettings()
    """How to treat a container that an operator stopped, paused or removed. `heal`: like a failure; `advise`: raise an alarm and
    only recommend an action; `respect`: put it on hold. One value, or one each for `ground` and `air`."""
    hold: Annotated[Seconds, Field(ge=1, le=86400)] = 600.0
    """How long a hold lasts without `phm hold --for`, and after a stop or a pause that is respected."""
    hold_max: Annotated[Seconds, Field(ge=1, le=86400)] = 14400.0
    """The longest hold that `phm hold` accepts."""
    relieve: Annotated[list[Name], Field(max_length=16)] = Field(default_factory=list)
    """Containers, none of them flight-critical or needed by one that is, whose CPU weight is lowered while a flight-critical
    container with `recover: true` waits for a CPU because of others, and restored afterwards."""
    maintenance: Annotated[list[MaintenanceSettings], Field(max_length=16)] = Field(default_factory=list)
    """Times in which containers are on hold. A container's label `phm.maintenance` has the same effect."""
    ladders: dict[str, list[str]] = Field(default_factory=dict)
    """Per condition, the actions in order, replacing the built-in ladder, e.g. `unhealthy: [restart]`."""
