"""Slot 1: rules of the companion check."""

from __future__ import annotations

from phm import api, testing
from phm_checks.companion import Companion


def check() -> api.Check:
    (one,) = Companion.build(testing.settings())
    return one


def run(judge: api.Check, world: api.World) -> api.Result:
    result = judge.run(world)
    assert isinstance(result, api.Result)
    return result


def test_all_well_is_ok() -> None:
    """A PHM without problems is OK."""
    result = run(check(), testing.world())
    assert result.level is api.Level.OK
    assert result.values["uptime_s"] == 60.0


def test_troubles_of_phm_itself_are_warnings() -> None:
    """Overdue checks, lost events and problems are told, all in one summary."""
    myself = testing.FakeSelf(
        overdue=("files/ros_app",), dropped={"mavlink": 3, "log": 0}, problems=("log: no space left",)
    )
    result = run(check(), testing.world(myself=myself))
    assert (result.level, result.condition) == (api.Level.WARN, "check_overdue")
    for part in ("files/ros_app", "mavlink 3", "no space left"):
        assert part in result.summary
    assert "log 0" not in result.summary


def test_the_links_are_not_its_business() -> None:
    """A closed link and a lost ground station are told by checks of their own, once."""
    links = testing.FakeLinks(gcs_age_s=60.0, links=(api.LinkFact("radio", False, "no such device"),))
    assert run(check(), testing.world(links=links)).level is api.Level.OK
