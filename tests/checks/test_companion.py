"""Slot 1: rules of the companion check."""

from __future__ import annotations

from phm import api, testing
from phm_checks.companion import Companion


def check() -> api.Check:
    (one,) = Companion.build(testing.settings(mavlink={"gcs_timeout": "10s"}))
    return one


def run(judge: api.Check, world: api.World) -> api.Result:
    result = judge.run(world)
    assert isinstance(result, api.Result)
    return result


def test_all_well_is_ok() -> None:
    """A PHM without problems that hears its ground station is OK."""
    result = run(check(), testing.world())
    assert result.level is api.Level.OK
    assert result.values["gcs_age_s"] == 1.0


def test_a_ground_station_never_heard_is_ok_and_said() -> None:
    """Before the first heartbeat nothing was lost."""
    result = run(check(), testing.world(links=testing.FakeLinks(gcs_age_s=None)))
    assert result.level is api.Level.OK
    assert "no ground station heard yet" in result.summary


def test_a_ground_station_lost_is_an_error() -> None:
    """Silence beyond gcs_timeout is gcs_lost, with its age in the brief."""
    result = run(check(), testing.world(links=testing.FakeLinks(gcs_age_s=12.0)))
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "gcs_lost", "no GCS 12 s")


def test_the_lost_ground_station_is_not_told_each_second() -> None:
    """The brief changes only when the silence has doubled."""
    judge, links = check(), testing.FakeLinks(gcs_age_s=12.0)
    world, briefs = testing.world(links=links), []
    for age in range(12, 30):
        links.gcs_age = float(age)
        briefs.append(run(judge, world).brief)
    assert list(dict.fromkeys(briefs)) == ["no GCS 12 s", "no GCS 25 s"]


def test_a_closed_link_is_a_warning() -> None:
    """A MAVLink endpoint that cannot be opened is told with its reason."""
    links = testing.FakeLinks(links=(api.LinkFact("radio", False, "no such device"), api.LinkFact("gcs", True)))
    result = run(check(), testing.world(links=links))
    assert (result.level, result.condition, result.brief) == (api.Level.WARN, "link_closed", "radio closed")
    assert "no such device" in result.summary


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


def test_the_lost_ground_station_outweighs_a_warning() -> None:
    """The worst finding gives level, brief and condition."""
    world = testing.world(links=testing.FakeLinks(gcs_age_s=60.0), myself=testing.FakeSelf(problems=("log: full",)))
    result = run(check(), world)
    assert result.condition == "gcs_lost"
    assert "log: full" in result.summary
