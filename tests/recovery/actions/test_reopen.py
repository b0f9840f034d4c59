"""The action `reopen`, and links as targets of recovery."""

from __future__ import annotations

from typing import Any, cast

import pytest

from phm.core.model import Fault, Layer, Level, Result, Slot, Stamp
from phm.core.settings import ContainerSettings
from phm.recovery.actions.reopen import Reopen
from phm.recovery.base import ActionContext, ActionFailed, Target, TargetKind
from phm.recovery.fault_cases import History
from phm.recovery.policy import Act, Skip, decide
from phm.runtime.sections import action_settings
from phm.testing import settings

GROUND = Target.parse("link:ground", ())
APP = Target.of(ContainerSettings(name="ros_1", alias="ros_app", recover=True))


def fault(condition: str = "radio_silent") -> Fault:
    result = Result(Level.ERROR, "no RADIO_STATUS", "radio: no RADIO_STATUS", condition, "link:ground")
    return Fault("F1", "radio/ground", Slot.RADIO, Layer.LINK, result, Stamp(0.0, 0.0))


def run(target: Target, opened: bool = True) -> tuple[str, list[str]]:
    asked: list[str] = []

    def reopen(link: str, timeout_s: float) -> bool:
        asked.append(link)
        assert timeout_s < Reopen.deadline_s
        return opened

    context = ActionContext(
        cast(Any, None),
        action_settings(settings()),
        lambda key: None,
        lambda: None,
        lambda key, net: None,
        reopen=reopen,
    )
    return Reopen().run(target, fault(), context), asked


def test_reopen_opens_the_link_of_the_target() -> None:
    """By its name, whatever characters a URL has."""
    assert run(GROUND) == ("reopened the MAVLink endpoint ground", ["ground"])
    assert run(Target.parse("link:tcp:10.0.0.1:5760", ()))[1] == ["tcp:10.0.0.1:5760"]


def test_a_link_that_does_not_reopen_is_a_failure() -> None:
    """With a message for the log."""
    with pytest.raises(ActionFailed, match="ground did not open again"):
        run(GROUND, opened=False)


def test_reopen_rejects_a_container() -> None:
    """A ladder that names it for a container is reported as wrong."""
    with pytest.raises(ActionFailed, match=r"ros_app is a container: correct recovery\.ladders"):
        run(APP)


def test_a_link_is_distinguished_from_a_container() -> None:
    """By the prefix, which no container's name can have; the manual step matches the kind."""
    assert (GROUND.kind, GROUND.key, GROUND.name, GROUND.opted_in) == (TargetKind.LINK, "ground", "link:ground", False)
    assert (APP.kind, APP.key, APP.name, APP.opted_in) == (TargetKind.CONTAINER, "ros_app", "ros_app", True)
    assert "docker logs --tail 50 ros_1" in APP.manual_step()
    assert "ground" in GROUND.manual_step()


@pytest.mark.parametrize("condition", ["link_silent", "radio_silent", "autopilot_silent"])
@pytest.mark.parametrize("mode", ["act", "advise", "off"])
def test_reopen_is_decided_in_any_mode_and_while_armed(condition: str, mode: str) -> None:
    """It affects only PHM's own endpoint, so opt-in and arming do not restrict it; budget and back-off do."""
    chosen = settings(recovery={"mode": mode}).recovery
    decision = decide(
        fault(condition),
        History(),
        10.0,
        target=GROUND,
        forbids=lambda action: "it is armed",
        settings=chosen,
        unrestricted=frozenset({"reopen"}),
    )
    assert decision == Act("reopen", 1)


def test_a_link_has_not_opted_in_to_container_actions() -> None:
    """A user's ladder with a container's action has no effect on a link."""
    chosen = settings(recovery={"ladders": {"radio_silent": ["restart"]}}).recovery
    decision = decide(
        fault(),
        History(),
        10.0,
        target=GROUND,
        forbids=lambda action: "",
        settings=chosen,
        unrestricted=frozenset({"reopen"}),
    )
    assert isinstance(decision, Skip)
