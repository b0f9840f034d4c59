"""Slot 1: rules of the check of the ground station."""

from __future__ import annotations

from phm import api, testing
from phm_checks.gcs import Gcs

GROUND = {"url": "tcp:10.0.0.1:5760", "name": "ground"}


def check(*endpoints: dict[str, str]) -> api.Check:
    (one,) = Gcs.build(testing.settings(mavlink={"gcs_timeout": "10s", "endpoints": list(endpoints or (GROUND,))}))
    return one


def run(judge: api.Check, links: testing.FakeLinks) -> api.Result:
    result = judge.run(testing.world(links=links))
    assert isinstance(result, api.Result)
    return result


def heard(age_s: float | None, **more: object) -> testing.FakeLinks:
    links = testing.FakeLinks(gcs_age_s=age_s, links=(api.LinkFact("ground", open=True),), **more)  # type: ignore[arg-type]
    links.gcs_link = "ground"
    return links


def test_without_a_link_to_the_ground_there_is_nothing_to_judge() -> None:
    """No endpoints, or only one that leads to the autopilot alone: no check."""
    assert not list(Gcs.build(testing.settings()))
    pilot = {"url": "/dev/ttyACM0", "leads_to": "autopilot"}
    assert not list(Gcs.build(testing.settings(mavlink={"endpoints": [pilot]})))


def test_a_ground_station_that_is_heard_is_ok() -> None:
    """With who it is, and by which link."""
    result = run(check(), heard(1.0))
    assert result.level is api.Level.OK
    assert result.values == {"gcs_age_s": 1.0, "gcs": "255/190", "link": "ground"}


def test_a_ground_station_never_heard_is_ok_and_said() -> None:
    """Before the first heartbeat nothing was lost."""
    result = run(check(), heard(None))
    assert result.bypass
    assert "no ground station heard yet" in result.summary


def test_a_ground_station_lost_is_an_error() -> None:
    """Silence beyond gcs_timeout is gcs_lost, with its age in the brief."""
    result = run(check(), heard(12.0))
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "gcs_lost", "GCS: no heartbeat 12 s")
    assert result.target == ""


def test_the_lost_ground_station_is_not_told_each_second() -> None:
    """The brief changes only when the silence has doubled."""
    judge, links = check(), heard(12.0)
    briefs = []
    for age in range(12, 30):
        links.gcs_age = float(age)
        briefs.append(run(judge, links).brief)
    assert list(dict.fromkeys(briefs)) == ["GCS: no heartbeat 12 s", "GCS: no heartbeat 25 s"]


def test_behind_closed_links_it_is_not_known() -> None:
    """A closed link is a fault of its own; nothing is known of what is behind it."""
    links = testing.FakeLinks(gcs_age_s=30.0, links=(api.LinkFact("ground", open=False),))
    assert run(check(), links).level is api.Level.STALE


def test_a_radio_that_fell_silent_with_it_is_waited_for() -> None:
    """It may be the radio's fault; one that was heard since is well, and the advice says so."""
    together = heard(12.0, radios=(api.RadioFact("ground", 13.0, 10.0),))
    assert run(check(), together).level is api.Level.STALE
    since = heard(12.0, radios=(api.RadioFact("ground", 6.0, 10.0),))
    result = run(check(), since)
    assert result.level is api.Level.ERROR
    assert "radio aboard answers" in result.summary


def test_a_radio_that_is_not_judged_is_not_waited_for() -> None:
    """With `radio: off` nobody would ever tell that it is the radio's fault."""
    links = heard(12.0, radios=(api.RadioFact("ground", 13.0, 10.0),))
    assert run(check({**GROUND, "radio": "off"}), links).level is api.Level.ERROR
