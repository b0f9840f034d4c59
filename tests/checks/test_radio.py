"""Slot 11: rules of the telemetry radio check."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from phm import api, testing
from phm_checks.radio import Radio

HEALTHY = api.RadioFact("ground", 0.5, 2.0, 180, 175, 40, 45, 98, 140.0, 130.0, 0.2, 0.1)
OPEN = api.LinkFact("ground", open=True, rx_age_s=0.5)


def check(radio: str = "auto", **mavlink: Any) -> api.Check:
    endpoint = {"url": "/dev/ttyUSB0", "name": "ground", "radio": radio}
    (one,) = Radio.build(testing.settings(mavlink={"endpoints": [endpoint], **mavlink}))
    return one


def run(radio_check: api.Check, *radios: api.RadioFact, link: api.LinkFact = OPEN) -> api.Result:
    result = radio_check.run(testing.world(links=testing.FakeLinks(links=(link,), radios=radios)))
    assert isinstance(result, api.Result)
    return result


def changed(**fields: Any) -> api.RadioFact:
    return dataclasses.replace(HEALTHY, **fields)


def test_a_radio_is_expected_on_ground_links() -> None:
    """Unless it is `off`; a required radio is expected on any link."""
    entries = [
        {"url": "tcp:10.0.0.1:1", "name": "a"},
        {"url": "tcp:10.0.0.1:2", "name": "b", "radio": "off"},
        {"url": "tcp:10.0.0.1:3", "name": "c", "leads_to": "autopilot"},
        {"url": "tcp:10.0.0.1:4", "name": "d", "leads_to": "autopilot", "radio": "required"},
    ]
    units = [one.units[0].id for one in Radio.build(testing.settings(mavlink={"endpoints": entries}))]
    assert units == ["radio/a", "radio/d"]


def test_a_working_radio_is_ok() -> None:
    """Its numbers are in the record."""
    result = run(check(), HEALTHY)
    assert result.level is api.Level.OK
    expected = {"rssi": 180, "remrssi": 175, "noise": 40, "remnoise": 45, "txbuf_percent": 98, "margin": 140.0}
    assert {name: result.values[name] for name in expected} == expected
    assert (result.values["rxerrors_s"], result.values["fixed_s"]) == (0.2, 0.1)


def test_a_radio_that_was_never_received_is_a_fault_only_if_required() -> None:
    """Then it is a fault, half a minute after the start."""
    result = run(check())
    assert result.bypass and result.evidence.unobserved, "it may also be still lost after a restart of PHM"
    result = run(check("required"))
    assert (result.level, result.condition, result.brief) == (api.Level.ERROR, "radio_silent", "radio: no RADIO_STATUS")
    just_begun = testing.world(links=testing.FakeLinks(links=(OPEN,)), daemon=testing.FakeSelf(uptime_s=10.0))
    waited = check("required").run(just_begun)
    assert isinstance(waited, api.Result)
    assert waited.level is api.Level.STALE


def test_a_silent_radio_is_an_error() -> None:
    """Silence beyond `radio_timeout` is reported with its duration, as a stable number."""
    radio_check = check()
    result = run(radio_check, changed(age_s=6.0))
    assert (result.level, result.condition, result.brief) == (
        api.Level.ERROR,
        "radio_silent",
        "radio: no RADIO_STATUS 6 s",
    )
    assert run(radio_check, changed(age_s=8.0)).brief == "radio: no RADIO_STATUS 6 s"
    assert run(radio_check, changed(age_s=13.0)).brief == "radio: no RADIO_STATUS 13 s"


def test_the_timeout_follows_the_period_of_the_radio() -> None:
    """It responds to PHM's heartbeats: if they are 10 s apart, its silence is detected after 25 s."""
    assert run(check(), changed(age_s=24.0, due_s=10.0)).level is api.Level.OK
    assert run(check(), changed(age_s=26.0, due_s=10.0)).level is api.Level.ERROR


def test_the_link_is_reopened_only_if_nothing_is_received_on_it() -> None:
    """While other frames arrive, the port works, and reopening it would not help."""
    lost = changed(age_s=6.0)
    assert run(check(), lost).target == ""
    silent = dataclasses.replace(OPEN, rx_age_s=6.0)
    assert run(check(), lost, link=silent).target == "link:ground"
    never = dataclasses.replace(OPEN, rx_age_s=None)
    assert run(check("required"), link=never).target == "link:ground"


def test_behind_a_closed_link_the_radio_is_stale() -> None:
    """The link's own unit reports the cause."""
    assert run(check(), changed(age_s=60.0), link=api.LinkFact("ground", open=False)).level is api.Level.STALE


WEAK = [
    ({"margin": 12.0}, "radio_weak", "radio: weak, margin 12", "on board"),
    ({"remmargin": 9.0}, "radio_weak", "radio: weak, margin 9", "on the ground"),
    ({"txbuf": 15}, "radio_full", "radio: buffer full", "85 % full"),
    ({"rxerrors_s": 8.0}, "radio_errors", "radio: damaged packets", "8.0 damaged packets"),
]


@pytest.mark.parametrize(("fields", "condition", "brief", "words"), WEAK, ids=[one[2] for one in WEAK])
def test_a_poor_radio_link_is_a_warning(fields: dict[str, Any], condition: str, brief: str, words: str) -> None:
    """Low signal-to-noise at either end, a full buffer, damaged packets."""
    result = run(check(), changed(**fields))
    assert (result.level, result.condition, result.brief) == (api.Level.WARN, condition, brief)
    assert words in result.summary


def test_values_that_the_radio_does_not_report_are_ignored() -> None:
    """Radios without a noise value, and a first report without a rate."""
    silent = changed(margin=None, remmargin=None, rssi=None, noise=None, rxerrors_s=None, fixed_s=None)
    result = run(check(), silent)
    assert result.level is api.Level.OK
    assert result.values["margin"] is None


@pytest.mark.parametrize(
    ("name", "bad", "between", "good"),
    [("margin", 14.0, 17.0, 20.0), ("txbuf", 19, 25, 31), ("rxerrors_s", 6.0, 4.0, 2.0)],
)
def test_a_value_at_its_limit_does_not_flap(name: str, bad: float, between: float, good: float) -> None:
    """A bad value must become clearly better; a good one may go up to the limit."""
    radio_check = check()
    assert run(radio_check, changed(**{name: between})).level is api.Level.OK
    assert run(radio_check, changed(**{name: bad})).level is api.Level.WARN
    assert run(radio_check, changed(**{name: between})).level is api.Level.WARN
    assert run(radio_check, changed(**{name: good})).level is api.Level.OK
    assert run(radio_check, changed(**{name: between})).level is api.Level.OK


def test_limits_are_configurable() -> None:
    """`radio_margin`, `radio_errors` and `radio_timeout`; a limit of 0 errors disables it."""
    assert run(check(radio_margin=5), changed(margin=12.0)).level is api.Level.OK
    assert run(check(radio_errors=0), changed(rxerrors_s=50.0)).level is api.Level.OK
    assert run(check(radio_timeout="20s"), changed(age_s=15.0)).level is api.Level.OK


def test_two_radios_have_separate_lines() -> None:
    """With several endpoints each line names its own."""
    entries = [{"url": f"tcp:10.0.0.1:{n}", "name": f"r{n}"} for n in (1, 2)]
    checks = list(Radio.build(testing.settings(mavlink={"endpoints": entries})))
    lost = dataclasses.replace(HEALTHY, link="r2", age_s=6.0)
    links = testing.FakeLinks(links=(api.LinkFact("r1", open=True), api.LinkFact("r2", open=True)), radios=(lost,))
    results = [one.run(testing.world(links=links)) for one in checks]
    assert [result.brief for result in results if isinstance(result, api.Result)] == [
        "",
        "radio r2: no RADIO_STATUS 6 s",
    ]


def test_a_weak_signal_shows_that_the_radio_responds() -> None:
    """A fault of a silent radio is over."""
    result = run(check(), changed(margin=5.0))
    assert (result.level, result.condition, result.ends_fault) == (api.Level.WARN, "radio_weak", True)
