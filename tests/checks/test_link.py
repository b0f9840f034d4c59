"""Slot 1: rules of the MAVLink endpoint check. Reasons for a closed port: test_command_path.py."""

from __future__ import annotations

import dataclasses
import errno
from typing import Any

import pytest

from phm import api, testing
from phm_checks.link import Link

HEALTHY = api.LinkFact("ground", open=True, rx_age_s=0.2, rx_s=300.0, tx_s=15.0, frames_s=12.0, bad_s=0.0)
CLOSED = api.LinkFact("ground", open=False, error="Connection refused", code=errno.ECONNREFUSED)
SERIAL, TCP = "/dev/ttyUSB0", "tcp:10.0.0.1:5760"


def check(url: str = TCP, *others: dict[str, str], **more: Any) -> api.Check:
    entries = [{"url": url, "name": "ground", **more}, *others]
    return next(iter(Link.build(testing.settings(mavlink={"endpoints": entries}))))


def run(
    link_check: api.Check,
    link: api.LinkFact | None = HEALTHY,
    links: testing.FakeLinks | None = None,
    uptime_s: float = 60.0,
) -> api.Result:
    links = links or testing.FakeLinks()
    links.endpoints = (link,) if link is not None else ()
    result = link_check.run(testing.world(links=links, daemon=testing.FakeSelf(uptime_s=uptime_s)))
    assert isinstance(result, api.Result)
    return result


def changed(**fields: Any) -> api.LinkFact:
    return dataclasses.replace(HEALTHY, **fields)


def test_an_open_endpoint_is_ok() -> None:
    """The record has its traffic and the frame loss of each sender."""
    sender = api.SenderFact(1, 1, 0.2, 350, 2.5)
    result = run(check(), changed(senders=(sender,)))
    assert result.level is api.Level.OK
    expected = {"rx_bytes_s": 300.0, "tx_bytes_s": 15.0, "frames_s": 12.0, "senders": 1, "loss_1_1_percent": 2.5}
    assert {name: result.values[name] for name in expected} == expected


def test_an_endpoint_before_its_first_attempt_is_stale() -> None:
    """Its thread has just started."""
    assert run(check(), None).level is api.Level.STALE


def test_a_closed_endpoint_is_an_error_without_recovery() -> None:
    """The endpoint reopens itself as soon as possible."""
    result = run(check(), CLOSED)
    assert (result.level, result.condition, result.brief, result.target) == (
        api.Level.ERROR,
        "link_closed",
        "link: refused",
        "",
    )
    assert TCP in result.summary


def test_a_port_that_closes_while_the_autopilot_reboots_on_command_is_a_warning() -> None:
    """It is a USB port, or the TCP port of a simulation; not where the autopilot is elsewhere."""
    rebooting = testing.FakeLinks(autopilot=api.AutopilotFact(4.0, False, link="ground", rebooting_s=4.2))
    result = run(check(), CLOSED, rebooting)
    assert (result.level, result.condition) == (api.Level.WARN, "link_closed")
    assert "acknowledged a command to reboot" in result.summary
    assert run(check(leads_to="ground"), CLOSED, rebooting).level is api.Level.ERROR


def test_the_peer_of_an_endpoint_may_start_after_phm() -> None:
    """An endpoint that was never open gets some time first; one that was open and is lost does not."""
    link_check = check()
    assert run(link_check, CLOSED, uptime_s=29.0).level is api.Level.STALE
    assert run(link_check, CLOSED, uptime_s=31.0).level is api.Level.ERROR
    link_check = check()
    run(link_check, HEALTHY, uptime_s=3.0)
    assert run(link_check, CLOSED, uptime_s=5.0).level is api.Level.ERROR


def test_a_closed_endpoint_among_others_is_named() -> None:
    """With several endpoints the line says which one."""
    result = run(check(TCP, {"url": "tcp:10.0.0.1:5762", "name": "spare"}), CLOSED)
    assert result.brief == "link ground: refused"


def received_by(gcs: str, pilot: str = "") -> testing.FakeLinks:
    autopilot = api.AutopilotFact(0.5, False, link=pilot) if pilot else None
    links = testing.FakeLinks(gcs_age_s=1.0, autopilot=autopilot)
    links.gcs_link = gcs
    return links


@pytest.mark.parametrize(
    ("gcs", "pilot", "level"),
    [
        ("spare", "spare", api.Level.WARN),
        ("spare", "", api.Level.WARN),
        ("spare", "ground", api.Level.ERROR),
        ("ground", "spare", api.Level.ERROR),
    ],
    ids=["all by the other", "no autopilot at all", "the autopilot not", "the ground not"],
)
def test_a_lost_redundant_endpoint_is_a_warning(gcs: str, pilot: str, level: api.Level) -> None:
    """An endpoint counts as lost if another one does not receive all that it leads to."""
    link_check = check(TCP, {"url": "tcp:10.0.0.1:5762", "name": "spare"})
    assert run(link_check, CLOSED, received_by(gcs, pilot)).level is level


def test_an_endpoint_to_one_side_is_lost_for_that_side_only() -> None:
    """`leads_to` selects the side."""
    link_check = check(TCP, leads_to="ground")
    assert run(link_check, CLOSED, received_by("spare", "ground")).level is api.Level.WARN
    link_check = check(TCP, leads_to="autopilot")
    assert run(link_check, CLOSED, received_by("ground", "spare")).level is api.Level.WARN
    assert run(link_check, CLOSED, received_by("spare", "ground")).level is api.Level.ERROR
    assert run(link_check, CLOSED, received_by("spare")).level is api.Level.ERROR


def test_the_endpoint_to_the_other_agents_has_no_substitute() -> None:
    """Ground station and autopilot on other endpoints do not replace it, and the operator's line has its name."""
    result = run(
        check(TCP, {"url": "tcp:10.0.0.1:5762", "name": "spare"}, leads_to="peers"), CLOSED, received_by("spare")
    )
    assert result.level is api.Level.ERROR
    assert result.brief.startswith("link ground:")


def test_bytes_without_frames_are_an_error() -> None:
    """The wrong baud rate or another protocol; a few bytes prove nothing."""
    garbage = changed(rx_s=400.0, frames_s=0.0, bad_s=90.0)
    result = run(check(SERIAL), garbage)
    assert (result.level, result.condition) == (api.Level.ERROR, "link_undecodable")
    assert "57600 baud" in result.summary
    assert run(check(SERIAL), changed(rx_s=5.0, frames_s=0.0)).level is api.Level.OK


@pytest.mark.parametrize(
    ("fields", "condition"),
    [
        ({"verified_s": 0.2, "frame_bytes_s": 20.0, "bad_s": 90.0}, ""),
        ({"verified_s": 0.0, "frame_bytes_s": 290.0}, ""),
        ({"verified_s": 0.0, "frame_bytes_s": 40.0}, "link_undecodable"),
        ({"verified_s": 0.0, "frame_bytes_s": 290.0, "bad_s": 12.0}, "link_undecodable"),
    ],
    ids=["noisy", "unknown messages", "few bytes in frames", "more false starts than frames"],
)
def test_frames_by_chance_are_not_valid(fields: dict[str, float], condition: str) -> None:
    """Without a single correct checksum, they must be most of what arrives."""
    assert run(check(SERIAL), changed(**fields)).condition == condition


def test_line_errors_are_a_warning() -> None:
    """Framing errors and overruns, if the driver counts them."""
    result = run(check(SERIAL), changed(line=api.LineFact(3.0, 0.0, 0.0)))
    assert (result.level, result.condition, result.brief) == (api.Level.WARN, "line_errors", "port: framing errors")
    result = run(check(SERIAL), changed(line=api.LineFact(0.0, 5.0, 0.0)))
    assert (result.level, result.brief) == (api.Level.WARN, "port: overruns")
    assert run(check(SERIAL), changed(line=api.LineFact(0.2, 0.0, 0.0))).level is api.Level.OK


def lossy(percent: float | None, system: int = 1, component: int = 1) -> api.LinkFact:
    return changed(senders=(api.SenderFact(system, component, 0.2, 300, percent),))


def test_lost_frames_of_the_neighbour_are_a_warning() -> None:
    """Of the autopilot on its own port; the number is stable, and at its limit the warning does not flap."""
    link_check = check(SERIAL)
    result = run(link_check, lossy(25.0))
    assert (result.level, result.condition, result.brief) == (api.Level.WARN, "frames_lost", "port: 25% frames lost")
    assert run(link_check, lossy(18.0)).level is api.Level.WARN
    assert run(link_check, lossy(10.0)).level is api.Level.OK
    assert run(link_check, lossy(18.0)).level is api.Level.OK
    assert run(link_check, lossy(None)).level is api.Level.OK


def test_gaps_of_other_senders_are_only_recorded() -> None:
    """An autopilot and a router hold back frames not meant for PHM, which leaves gaps in the ground station's sequence."""
    result = run(check(SERIAL), lossy(60.0, 255, 190))
    assert result.level is api.Level.OK
    assert result.values["loss_255_190_percent"] == 60.0
    assert run(check(TCP), lossy(60.0)).level is api.Level.OK


def test_behind_a_radio_the_neighbour_is_the_ground_station() -> None:
    """A radio is like a cable: what the ground station sends arrives here."""
    link_check = check(SERIAL, leads_to="ground")
    assert run(link_check, lossy(60.0, 255, 190)).brief == "port: 60% frames lost"
    assert run(link_check, lossy(60.0, 255, 190), testing.FakeLinks(gcs_age_s=None)).level is api.Level.OK


def test_a_reconnected_router_gets_time_to_send() -> None:
    """Silence while the link was closed does not count for the open one: reopening it would cut off incoming data."""
    clock, link_check = testing.FakeClock(), check(leads_to="router")
    senders = tuple(api.SenderFact(system, 1, 20.0, 350, 0.0) for system in (1, 255))
    links = testing.FakeLinks()

    def observe(link: api.LinkFact) -> str:
        links.endpoints = (link,)
        result = link_check.run(testing.world(links=links, clock=clock))
        assert isinstance(result, api.Result)
        return result.condition

    silent = changed(rx_age_s=20.0, senders=senders)
    assert observe(HEALTHY) == ""
    assert observe(CLOSED) == "link_closed"
    assert observe(silent) == ""
    clock.advance(4.0)
    assert observe(silent) == "link_silent"


def refused(times: int) -> api.LinkFact:
    return dataclasses.replace(CLOSED, failed=times)


def test_a_terminated_router_is_reported_at_the_second_refusal() -> None:
    """It was open for a while, and no process listens any more; one refusal may be a restart."""
    link_check, world = check(), testing.world(links=testing.FakeLinks(links=(HEALTHY,)))
    link_check.run(world)
    assert run(link_check, refused(1)).settle_s is None
    assert (run(link_check, refused(2)).level, run(link_check, refused(2)).settle_s) == (api.Level.ERROR, 0.0)


def test_a_router_that_comes_and_goes_gets_the_usual_time() -> None:
    """It was open for a moment only: a restart loop is not reported any faster."""
    clock, links = testing.FakeClock(), testing.FakeLinks(links=(CLOSED,))
    link_check, world = check(), testing.world(links=links, clock=clock)
    for link, after_s, settle_s in (
        (HEALTHY, 6.0, None),
        (refused(2), 1.0, 0.0),
        (HEALTHY, 1.0, None),
        (refused(2), 1.0, None),
    ):
        links.endpoints = (link,)
        result = link_check.run(world)
        assert isinstance(result, api.Result)
        assert result.settle_s == settle_s
        clock.advance(after_s)


def test_an_error_other_than_a_refusal_gets_the_usual_time() -> None:
    """The network may be down for a moment."""
    link_check = check()
    run(link_check)
    lost = dataclasses.replace(CLOSED, error="the other side closed the connection", code=0, failed=3)
    assert run(link_check, lost).settle_s is None


def test_lost_frames_show_that_the_link_is_open() -> None:
    """A fault of a closed endpoint is over."""
    senders = (api.SenderFact(1, 1, 0.2, 350, 60.0),)
    result = run(check(SERIAL, leads_to="autopilot"), changed(senders=senders))
    assert (result.level, result.condition, result.ends_fault) == (api.Level.WARN, "frames_lost", True)


def test_the_name_of_the_host_needs_a_line_of_the_compose_file() -> None:
    """Docker gives it to no container by itself."""
    error = "the name host.docker.internal is not known: Name or service not known"
    link_check = check("udpout:host.docker.internal:14551")
    assert "`extra_hosts:" in run(link_check, api.LinkFact("ground", open=False, error=error)).summary
    assert "extra_hosts" not in run(link_check, CLOSED).summary
