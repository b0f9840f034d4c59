"""Slot 1: rules of the ground station check."""

from __future__ import annotations

import dataclasses

from phm import api, testing
from phm_checks.gcs import Gcs

GROUND = {"url": "tcp:10.0.0.1:5760", "name": "ground"}


def check(*endpoints: dict[str, str]) -> api.Check:
    (one,) = Gcs.build(testing.settings(mavlink={"gcs_timeout": "10s", "endpoints": list(endpoints or (GROUND,))}))
    return one


def run(gcs_check: api.Check, links: testing.FakeLinks) -> api.Result:
    result = gcs_check.run(testing.world(links=links))
    assert isinstance(result, api.Result)
    return result


def gcs_links(age_s: float | None, **more: object) -> testing.FakeLinks:
    links = testing.FakeLinks(gcs_age_s=age_s, links=(api.LinkFact("ground", open=True),), **more)  # type: ignore[arg-type]
    links.gcs_link = "ground"
    return links


def test_without_a_link_to_the_ground_no_check_is_built() -> None:
    """No endpoints, or only one that leads to the autopilot."""
    assert not list(Gcs.build(testing.settings()))
    pilot = {"url": "/dev/ttyACM0", "leads_to": "autopilot"}
    assert not list(Gcs.build(testing.settings(mavlink={"endpoints": [pilot]})))


def test_a_received_ground_station_is_ok() -> None:
    """With its system id and its link."""
    result = run(check(), gcs_links(1.0))
    assert result.level is api.Level.OK
    assert result.values == {"gcs_age_s": 1.0, "gcs": "255/190", "link": "ground"}


def test_a_ground_station_that_was_never_received_is_ok_with_a_note() -> None:
    """Before the first heartbeat nothing was lost."""
    result = run(check(), gcs_links(None))
    assert result.bypass and result.evidence.unobserved, "it may also be still lost after a restart of PHM"
    assert "no ground station heartbeat received yet" in result.summary


def test_a_ground_station_that_announced_its_end_is_not_lost() -> None:
    """However long it is away."""
    links = gcs_links(600.0)
    fact = links.gcs()
    assert fact is not None
    links.gcs = lambda: dataclasses.replace(fact, left=True)  # type: ignore[method-assign]
    result = run(check(), links)
    assert (result.bypass, result.summary) == (True, "the last ground station has announced its end")
    assert not result.evidence.unobserved


def test_a_lost_ground_station_is_an_error() -> None:
    """Silence beyond `gcs_timeout` is `gcs_lost`, with its duration in the brief."""
    result = run(check(), gcs_links(12.0))
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "gcs_lost", "GCS: no heartbeat 12 s")
    assert result.target == ""


def test_a_lost_ground_station_is_not_reported_every_second() -> None:
    """The brief changes only when the silence has doubled."""
    gcs_check, links = check(), gcs_links(12.0)
    briefs = []
    for age in range(12, 30):
        links.gcs_age = float(age)
        briefs.append(run(gcs_check, links).brief)
    assert list(dict.fromkeys(briefs)) == ["GCS: no heartbeat 12 s", "GCS: no heartbeat 25 s"]


def test_behind_closed_links_the_ground_station_is_stale() -> None:
    """A closed link is its own fault and hides everything behind it."""
    links = testing.FakeLinks(gcs_age_s=30.0, links=(api.LinkFact("ground", open=False),))
    assert run(check(), links).level is api.Level.STALE


def test_a_radio_that_fell_silent_too_is_checked_first() -> None:
    """It may be the cause; a radio that was received since works, and the advice says so."""
    together = gcs_links(12.0, radios=(api.RadioFact("ground", 13.0, 10.0),))
    assert run(check(), together).level is api.Level.STALE
    since = gcs_links(12.0, radios=(api.RadioFact("ground", 6.0, 10.0),))
    result = run(check(), since)
    assert result.level is api.Level.ERROR
    assert "onboard radio responds" in result.summary


def test_a_radio_without_a_check_is_not_waited_for() -> None:
    """With `radio: off` no unit could report the radio as the cause."""
    links = gcs_links(12.0, radios=(api.RadioFact("ground", 13.0, 10.0),))
    assert run(check({**GROUND, "radio": "off"}), links).level is api.Level.ERROR


ALONE = api.RadioFact("ground", 0.4, 1.0, rssi=180, alone=True)


def test_a_radio_without_contact_to_the_ground_radio_shortens_the_detection() -> None:
    """It reports that nothing arrives from the ground: no need for the full timeout, and the line says where to look."""
    result = run(check(), gcs_links(3.6, radios=(ALONE,)))
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "gcs_lost", "GCS: no heartbeat 4 s")
    assert "receives nothing from the ground radio" in result.summary


def test_a_radio_without_contact_rules_out_a_lack_of_cpu_time() -> None:
    """Until the ground station is received again: that PHM reads its reports in time shows that it reads."""
    gcs_check = check()

    def conclusive(age_s: float, *radios: api.RadioFact) -> bool:
        return run(gcs_check, gcs_links(age_s, radios=radios)).evidence.conclusive

    late = dataclasses.replace(ALONE, age_s=2.0)
    assert not conclusive(3.6, late)
    assert [conclusive(4.6, ALONE), conclusive(5.6, late)] == [True, True]
    assert [conclusive(0.2, ALONE), conclusive(3.6, late)] == [False, False]


def test_a_radio_without_contact_does_not_contradict_a_received_ground_station() -> None:
    """Nor one that is received by another link, nor if the report is older than the last heartbeat."""
    assert run(check(), gcs_links(1.0, radios=(ALONE,))).level is api.Level.OK
    assert run(check(), gcs_links(3.6, radios=(dataclasses.replace(ALONE, link="other"),))).level is api.Level.OK
    assert run(check(), gcs_links(3.6, radios=(dataclasses.replace(ALONE, age_s=3.8),))).level is api.Level.OK


def overdue(age_s: float, **more: object) -> testing.FakeLinks:
    links = gcs_links(age_s, **more)
    links.gcs_due_s, links.gcs_overdue = 5.0, True
    return links


def test_a_regular_ground_station_is_lost_before_the_timeout() -> None:
    """It never paused for this long; the text has the expected time."""
    result = run(check(), overdue(5.3))
    assert (result.level, result.condition) == (api.Level.ERROR, "gcs_lost")
    assert "expected one within 5.0 s" in result.summary


def test_with_a_working_radio_link_the_timeout_applies() -> None:
    """Heartbeats get lost in bursts on the radio link, and the operator's program may freeze for a moment."""
    working = api.RadioFact("ground", 0.4, 1.0, rssi=180, remrssi=170)
    assert run(check(), overdue(5.3, radios=(working,))).level is api.Level.OK
    assert run(check(), overdue(10.5, radios=(working,))).level is api.Level.ERROR


def test_before_the_timeout_the_check_waits_while_the_radio_may_be_the_cause() -> None:
    """The radio does not report its link and is overdue itself."""
    together = overdue(5.3, radios=(api.RadioFact("ground", 5.5, 2.0),))
    assert run(check(), together).level is api.Level.OK
    closed = testing.FakeLinks(gcs_age_s=5.3, links=(api.LinkFact("ground", open=False),), radios=(ALONE,))
    closed.gcs_link = "ground"
    assert run(check(), closed).level is api.Level.STALE


def test_a_short_contact_between_the_radios_does_not_end_the_fault() -> None:
    """At the edge of the radio's range the fault ends with the next heartbeat only."""
    clock, links, gcs_check = testing.FakeClock(), gcs_links(3.6, radios=(ALONE,)), check()
    levels = []
    for age_s, remrssi in ((3.6, None), (4.6, 150), (5.6, None), (0.2, 150), (1.2, 150)):
        links.gcs_age = age_s
        links.radio_facts = (dataclasses.replace(ALONE, age_s=0.1, remrssi=remrssi, alone=remrssi is None),)
        result = gcs_check.run(testing.world(links=links, clock=clock))
        assert isinstance(result, api.Result)
        levels.append(result.level)
        clock.advance(1.0)
    assert levels == [api.Level.ERROR] * 3 + [api.Level.OK] * 2
