"""What the page says about a request before it is sent."""

from __future__ import annotations

from typing import Any

import pytest

from phm.core.model import Level, Slot
from phm.gcs.web.choices import choices
from phm.wire import tunnel
from tests.gcs.bench import Ground, autopilot, phm_heartbeat, tunnel_frame

UNKNOWN = "again. It is not known whether the vehicle is armed. The"


@pytest.fixture
def ground() -> Ground:
    """Agent 7 has named its container."""
    made = Ground()
    made.receive(phm_heartbeat(7, {Slot.CONTAINER: Level.ERROR}))
    made.receive(tunnel_frame(7, tunnel.details("containers", "1 ros_app")[0]))
    return made


def restart(row: dict[str, Any]) -> str:
    """What the confirmation of a restart says."""
    return str(next(one["will"] for one in choices(row) if one["do"] == "restart"))


def test_the_confirmation_of_a_restart_says_whether_the_vehicle_is_armed(ground: Ground) -> None:
    """Only a vehicle that is known to be disarmed needs no sentence."""
    ground.receive(autopilot(7, armed=True))
    assert "again. The vehicle is armed. The" in restart(ground.agent(7))
    ground.receive(autopilot(7))
    assert "starts it again. The agent decides" in restart(ground.agent(7))


def test_an_autopilot_that_was_never_received_may_be_armed(ground: Ground) -> None:
    """The confirmation says that this is unknown."""
    assert UNKNOWN in restart(ground.agent(7))


@pytest.mark.parametrize("armed", [False, True])
def test_an_autopilot_that_is_lost_may_be_armed(ground: Ground, armed: bool) -> None:
    """Whatever its last heartbeat said."""
    ground.receive(autopilot(7, armed=armed))
    ground.wait(60, phm_heartbeat(7, {Slot.CONTAINER: Level.ERROR}))
    row = ground.agent(7)
    assert (row["presence"], row["autopilot"]["presence"]) == ("alive", "lost")
    assert UNKNOWN in restart(row)
