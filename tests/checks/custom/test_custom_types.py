"""Checks of the types `http`, `process`, `command` and `log`."""

from __future__ import annotations

from typing import Any

import pytest

from phm import api, testing
from phm_checks._custom.command import MOST_VALUES, performance, split_output
from phm_checks.custom import Custom

URL = "http://camera/state"
OK, WARN, ERROR = api.Level.OK, api.Level.WARN, api.Level.ERROR


def build(**entry: Any) -> api.Check:
    (check,) = Custom.build(testing.settings(containers=[{"name": "app"}], custom=[{"name": "x", **entry}]))
    return check


def run(check: api.Check, **world: Any) -> api.Result:
    result = check.run(testing.world(**world))
    assert isinstance(result, api.Result)
    return result


# ------------------------------------------------------------ http


def page(code: int = 200, text: str = "", location: str = "", **entry: Any) -> api.Result:
    sockets = testing.FakeSockets()
    sockets.pages[URL] = api.HttpFact("", 0.1, code, location, text)
    return run(build(type="http", url=URL, **entry), sockets=sockets)


def test_the_status_of_a_page_is_compared() -> None:
    """200 unless the entry names others; a redirect says where it leads."""
    assert page().level is OK
    moved = page(302, location="http://elsewhere/")
    assert (moved.level, moved.brief) == (ERROR, "x HTTP 302") and "http://elsewhere/" in moved.summary
    assert page(204, status=[200, 204]).level is OK
    assert run(build(type="http", url=URL)).brief == "x no answer"


def test_the_body_must_match() -> None:
    """A page of another program has the right status, too."""
    assert page(text="state: flying", body="fly(ing)?").level is OK
    assert page(text="state: flying", body="landed").brief == "x wrong content"


@pytest.mark.parametrize(
    ("body", "entry", "problem"),
    [
        ('{"a": {"b": [1, 2]}}', {"json_field": "a.b.1", "equals": 2}, ""),
        ('{"a": {"b": [1, 2]}}', {"json_field": "a.b.1", "equals": 3}, "a.b.1 is 2, expected 3"),
        ('{"a": {"b": [1, 2]}}', {"json_field": "a.b.7"}, "no field 'a.b.7'"),
        ('{"ok": true}', {"json_field": "ok", "equals": True}, ""),
        ('{"ok": 1}', {"json_field": "ok", "equals": True}, "ok is 1, expected true"),
        ('{"ok": false}', {"json_field": "ok"}, "ok is false"),
        ('{"ok": "yes"}', {"json_field": "ok"}, ""),
        ("<html>", {"json_field": "ok"}, "not JSON"),
        ("[" * 60000, {"json_field": "ok"}, "not JSON"),
    ],
)
def test_a_field_of_a_json_body_is_compared(body: str, entry: dict[str, Any], problem: str) -> None:
    """By names and indexes; true is not 1."""
    result = page(text=body, **entry)
    assert result.level is (ERROR if problem else OK) and problem in result.summary


def test_the_query_of_an_address_is_not_shown() -> None:
    """It may have a key."""
    result = run(build(type="http", url="http://camera/state?key=secret"))
    assert "http://camera/state" in result.summary and "secret" not in result.summary + result.brief


# ------------------------------------------------------------ process


@pytest.mark.parametrize(
    ("entry", "level"),
    [
        ({}, OK),
        ({"min_count": 2}, OK),
        ({"min_count": 3}, ERROR),
        ({"max_count": 1}, ERROR),
        ({"min_count": 0, "max_count": 0}, ERROR),
    ],
)
def test_processes_are_counted(entry: dict[str, Any], level: api.Level) -> None:
    """Those whose command line has all words, of PHM's own namespace or of a container."""
    listed = tuple(api.ProcessFact(pid, command=f"/usr/bin/router --port {pid}") for pid in (7, 8))
    others = (*listed, api.ProcessFact(9, command="/usr/bin/router"), api.ProcessFact(10, command="vi --port"))
    programs, docker = testing.FakePrograms(), testing.FakeDocker(testing.container("app"))
    programs.listed = docker.lists["app"] = others
    words = {"type": "process", "process": ["router", "--port"]}
    assert run(build(**words, **entry), programs=programs).level is level
    inside = run(build(**words, **entry, container="app"), docker=docker)
    assert (inside.level, inside.values["processes"]) == (level, 2)


def test_processes_of_a_container_that_does_not_run_are_unknown() -> None:
    """Its own unit reports that."""
    check = build(type="process", process=["router"], container="app")
    with pytest.raises(api.CannotTell):
        run(check)
    (unit,) = check.units
    assert unit.needs == ("container/app",)


# ------------------------------------------------------------ command


def command(code: int, output: str, **entry: Any) -> api.Result:
    programs = testing.FakePrograms()
    programs.answers["", "check"] = api.ProgramFact(code, output, 0.1)
    return run(build(type="command", command=["check"], **entry), programs=programs)


def test_the_exit_code_is_the_level() -> None:
    """2 has the level of the entry."""
    assert [command(code, "text").level for code in (0, 1, 2)] == [OK, WARN, ERROR]
    assert command(2, "text", level="warn").level is WARN
    with pytest.raises(api.CannotTell, match="exit code 4: no output"):
        command(4, "")


def test_the_first_line_is_the_text() -> None:
    """Also for the operator, as one line of 38 ASCII characters at most."""
    result = command(2, "PUMP dry \x1b[31m since noon and much more text|p=1;2;3\nlong text\n|q=2")
    assert result.summary == "x: PUMP dry [31m since noon and much more text"
    assert len(result.brief) <= 38 and result.brief.isascii() and result.brief.isprintable()
    assert result.values == {"p": 1.0, "q": 2.0}
    assert command(2, "").summary == "x: exit code 2"


def test_performance_data_become_values_with_their_unit() -> None:
    """As the guidelines of the plug-ins define them; anything else is left out."""
    text, data = split_output(
        "OK | load1=0.5;15;30;0; '/ home'=12MB;;;0;99 'it''s'=7% x=U y=1e400 z=3c time=0.01s;1;2\n"
    )
    assert text == "OK"
    assert performance(data) == {
        "load1": 0.5, "/ home_MB": 12.0, "it's_percent": 7.0, "z_c": 3.0, "time_s": 0.01,
    }  # fmt: skip
    assert len(performance(" ".join(f"v{number}=1" for number in range(1000)))) == MOST_VALUES


def test_the_output_of_a_program_is_safe_to_print_also_in_a_stale_unit() -> None:
    """The reason of a STALE unit is shown, too."""
    with pytest.raises(api.CannotTell) as caught:
        command(9, "\x1b[2Jline" + "x" * 5000)
    assert str(caught.value).isprintable() and len(str(caught.value)) <= 300


# ------------------------------------------------------------ log


def test_a_found_pattern_is_a_failure_until_it_is_quiet() -> None:
    """Each further line prolongs it."""
    clock, logs = testing.FakeClock(), testing.FakeLogs()
    check = build(type="log", path="/app.log", patterns=[{"pattern": "ERROR (.*)"}], quiet=60)

    def observe(*lines: str) -> api.Result:
        logs.lines["x"] = list(lines)
        return run(check, clock=clock, logs=logs)

    assert observe("fine").level is OK
    found = observe("ERROR a", "ERROR b", "fine")
    assert (found.level, found.values["matches"], found.brief) == (ERROR, 2, "x log match")
    assert found.summary.endswith("newest line: ERROR b")
    clock.advance(59)
    assert observe("ERROR c").values["matches"] == 3
    clock.advance(59)
    assert observe().level is ERROR
    clock.advance(1)
    assert observe().level is OK
    assert check.failures == 1, "a second look would find nothing new"


def test_after_a_restart_of_phm_a_match_counts_until_the_log_is_quiet() -> None:
    """A reload remembers for how long it has been."""
    clock, logs, new = testing.FakeClock(), testing.FakeLogs(), testing.FakeLogs()
    wanted = {"type": "log", "path": "/app.log", "patterns": [{"pattern": "ERROR"}], "quiet": 60}
    logs.lines["x"] = ["ERROR a"]
    found = run(build(**wanted), clock=clock, logs=logs).evidence.subjects
    assert found == ("/app.log without 'ERROR'",)
    first = run(build(**wanted), clock=clock, logs=new)
    clock.advance(59)
    early = run(build(**wanted), clock=clock, logs=new)
    clock.advance(1)
    late = run(build(**wanted), clock=clock, logs=new)
    assert [each.evidence.unobserved_of for each in (first, early, late)] == [found, found, ()]
    assert {each.level for each in (first, early, late)} == {OK}
    for changed in ({"path": "/b.log"}, {"patterns": [{"pattern": "FATAL"}]}):
        other = run(build(**{**wanted, **changed}), clock=clock, logs=testing.FakeLogs())
        assert other.evidence.unobserved_of != found, "what is not configured any more is over"


def test_each_pattern_has_its_level() -> None:
    """An error has priority over a warning."""
    logs = testing.FakeLogs()
    patterns = [{"pattern": "slow", "level": "warn"}, {"pattern": "dead"}]
    check = build(type="log", container="app", patterns=patterns)
    logs.lines["x"] = ["slow"]
    assert run(check, logs=logs).level is WARN
    logs.lines["x"] = ["dead"]
    assert run(check, logs=logs).level is ERROR


def test_a_log_line_is_text() -> None:
    """An application may log what it received by radio."""
    logs = testing.FakeLogs()
    logs.lines["x"] = ["ERROR \x1b[2J" + "y" * 5000]
    result = run(build(type="log", path="/a", patterns=[{"pattern": "ERROR"}]), logs=logs)
    assert result.summary.isprintable() and len(result.summary) < 400


def test_a_restart_of_the_container_that_recovery_acts_on_ends_a_failure_of_its_log() -> None:
    """The line is of the former run: PHM would restart the container again for it. A line of the new run counts."""
    clock, logs, docker = testing.FakeClock(), testing.FakeLogs(), testing.FakeDocker(testing.container("app"))
    settings = testing.settings(
        containers=[{"name": "app", "recover": True}],
        custom=[{"name": "x", "type": "log", "container": "app", "patterns": [{"pattern": "FATAL"}],
                 "recovery": {"container": "app"}}],
    )  # fmt: skip
    (check,) = Custom.build(settings)

    def observe(*lines: str) -> api.Level:
        clock.advance(10)
        logs.lines["x"] = list(lines)
        return run(check, clock=clock, logs=logs, docker=docker).level

    assert [observe(), observe("FATAL"), observe()] == [OK, ERROR, ERROR]
    docker.change("app", status="exited")
    assert observe("FATAL while it stops") is ERROR
    docker.change("app", status="running", started_at="later")
    assert observe("FATAL while it stops") is OK
    assert [observe(), observe("FATAL"), observe()] == [OK, ERROR, ERROR]


def test_a_check_needs_the_container_it_looks_into_and_the_one_that_recovery_restarts() -> None:
    """A container that is down is one fault, and no reason to restart another."""
    settings = testing.settings(
        containers=[{"name": "app"}, {"name": "router", "recover": True}],
        custom=[{"name": "x", "type": "command", "command": ["check"], "container": "app",
                 "recovery": {"container": "router"}}],
    )  # fmt: skip
    (check,) = Custom.build(settings)
    (unit,) = check.units
    assert (unit.needs, unit.target) == (("container/router", "container/app"), "router")


def test_a_number_that_fluctuates_does_not_change_the_line_for_the_operator_each_time() -> None:
    """The ground receives each change, and six within a minute would be called flapping. Other words are shown immediately."""
    clock, programs = testing.FakeClock(), testing.FakePrograms()
    check = build(type="command", command=["check"])

    def observe(output: str, code: int = 2) -> api.Result:
        programs.answers["", "check"] = api.ProgramFact(code, output, 0.1)
        clock.advance(10)
        return run(check, clock=clock, programs=programs)

    results = [observe(f"LOAD {9 + 0.1 * number:g}") for number in range(12)]
    assert len({result.brief for result in results}) == 2, "once a minute"
    assert results[5].summary == "x: LOAD 9.5", "the log has the newest"
    assert observe("LOAD 8.1", code=1).brief == "x LOAD 8.1", "another level"
    assert observe("no sensor", code=1).brief == "x no sensor"
    assert (observe("fine", code=0).level, observe("no sensor 7").brief, observe("LOAD 9.9").brief) == (
        OK, "x no sensor 7", "x LOAD 9.9",
    )  # fmt: skip
