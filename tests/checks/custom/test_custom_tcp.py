"""Checks of type `tcp`, and what all types have in common."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks.custom import Custom

HOST, PORT = "camera", 554


def build(**entry: Any) -> api.Check:
    entry = {"name": "stream", "type": "tcp", "host": HOST, "port": PORT, **entry}
    containers = [{"name": "app", "recover": True}]
    (check,) = Custom.build(testing.settings(containers=containers, custom=[entry]))
    return check


def evaluate(check: api.Check, **fact: Any) -> api.Result:
    sockets = testing.FakeSockets()
    sockets.servers[HOST, PORT] = api.ConnectionFact(**{"problem": "", "took_s": 0.1, **fact})
    result = check.run(testing.world(sockets=sockets))
    assert isinstance(result, api.Result)
    return result


def test_a_connection_is_ok_and_its_duration_a_value() -> None:
    """Nothing else is expected by default."""
    result = evaluate(build())
    assert (result.level, result.values["took_s"]) == (api.Level.OK, 0.1)


def test_a_refused_connection_is_an_error_without_a_target() -> None:
    """Recovery is opt-in: without it the fault names nothing to act on."""
    result = evaluate(build(), problem="the connection was refused")
    assert (result.level, result.condition, result.target) == (api.Level.ERROR, "custom_failed", "")
    assert result.brief == "stream no connection" and "camera port 554: the connection was refused" in result.summary


@pytest.mark.parametrize("received", ["", "HTTP/1.1 400"])
def test_another_first_text_is_an_error(received: str) -> None:
    """A server of another kind may listen on the port."""
    check = build(expect="SSH-2.0")
    assert evaluate(check, received="SSH-2.0-OpenSSH").level is api.Level.OK
    assert evaluate(check, received=received).brief == "stream wrong answer"


def test_level_brief_advice_and_recovery_come_from_the_entry() -> None:
    """The user knows what a failure means and what to do."""
    keys = {"brief": "camera stream gone", "advice": "Check its power.", "recovery": {"container": "app"}}
    result = evaluate(build(**keys), problem="refused")
    assert (result.brief, result.target) == ("camera stream gone", "app")
    assert result.summary.endswith("Check its power.")
    assert evaluate(build(level="warn"), problem="refused").level is api.Level.WARN


def test_the_frame_of_an_entry_becomes_that_of_its_check() -> None:
    """Period, slot, failures, needs and grace are the entry's; a target is needed, too."""
    check = build(period=30, timeout=2, slot=15, failures=4, needs=["host"], recovery={"container": "app"}, grace=20)
    assert (check.period_s, check.slot, check.failures, check.deadline_s) == (30, 15, 4, 7)
    (unit,) = check.units
    assert (unit.id, unit.needs, unit.target, unit.grace_s) == ("custom/stream", ("container/app", "host"), "app", 20)
    assert check.wakes == {"container:app"}


def test_text_from_the_server_is_one_printable_line() -> None:
    """A server cannot write additional lines into the log, or long ones."""
    result = evaluate(build(expect="SSH"), received="\x1b[2J\n2026 SUCCESS " * 200)
    assert result.summary.isprintable() and len(result.summary) < 500
