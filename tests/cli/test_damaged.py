"""Damaged status files and logs: every verb that reads them reports the damage."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from hypothesis import HealthCheck, given, settings as hypothesis, strategies as st

from phm.cli import group
from phm.wire import status_file
from phm.wire.shape import TableShape, mismatch
from tests.cli.test_cli import DEAD, running
from tests.cli.test_faults import OPEN, RECOVERED, record

STRANGE = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.sampled_from([10**30, -1, 2**63, 1e308, -0.0]),
    st.text(max_size=5),
    st.just("\ud800"),
    st.just([]),
    st.just([None]),
    st.just([[]]),
    st.just({}),
    st.just({"fault": 3}),
    st.just([{}]),
).map(copy.deepcopy)


def places(value: Any) -> list[tuple[Any, Any]]:
    """Every (container, key) inside a JSON document."""
    keys = list(value) if isinstance(value, dict) else list(range(len(value))) if isinstance(value, list) else []
    return [place for key in keys for place in ((value, key), *places(value[key]))]


@pytest.fixture(scope="module")
def intact(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """A status file as the daemon writes it."""
    folder = tmp_path_factory.mktemp("intact")
    running(folder, DEAD)
    document: dict[str, Any] = json.loads((folder / "status.json").read_text())
    return document


def damaged(data: st.DataObject, document: dict[str, Any]) -> dict[str, Any]:
    found = copy.deepcopy(document)
    for _ in range(data.draw(st.integers(1, 3))):
        spots = places(found)
        if not spots:
            break
        holder, key = data.draw(st.sampled_from(spots))
        if isinstance(holder, dict) and data.draw(st.booleans()):
            del holder[key]
        else:
            holder[key] = data.draw(STRANGE)
    return found


def answered(result: Result) -> None:
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    assert result.exit_code in (0, 1)


@hypothesis(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_status_file_is_reported(data: st.DataObject, intact: dict[str, Any], tmp_path: Path) -> None:
    """`phm status` in each form, the image's healthcheck and `phm faults` never end with an exception."""
    (tmp_path / "log").mkdir(exist_ok=True)
    (tmp_path / "status.json").write_text(json.dumps(damaged(data, intact)))
    for words in (["status"], ["status", "--json"], ["status", "--healthy"]):
        answered(CliRunner().invoke(group, [*words, "--run-dir", str(tmp_path)]))
    faults = ["faults", "--log-dir", str(tmp_path / "log"), "--run-dir", str(tmp_path)]
    for more in ([], ["--json"], ["ab12-1"]):
        answered(CliRunner().invoke(group, [*faults, *more]))
    assert status_file.main([str(tmp_path)]) in (0, 1)


def test_every_text_of_a_status_file_can_be_printed(intact: dict[str, Any], tmp_path: Path) -> None:
    """A lone surrogate, which no encoding supports, is printed as an escape sequence, wherever it is."""
    for number in range(len(places(intact))):
        found = copy.deepcopy(intact)
        holder, key = places(found)[number]
        if isinstance(holder[key], str):
            holder[key] = "\ud800"
            (tmp_path / "status.json").write_text(json.dumps(found))
            answered(CliRunner().invoke(group, ["status", "--run-dir", str(tmp_path)]))


@pytest.mark.parametrize(
    "text",
    [
        '{"checks": 3}',
        '{"checks": {}, "alive": true}',
        '{"written_mono": NaN}',
        '{"pid": 1e999}',
        '"x"',
        "",
        "\x00" * 99,
    ],
)
def test_a_damaged_file_is_never_healthy(text: str, tmp_path: Path) -> None:
    """One sentence, exit code 1."""
    (tmp_path / "status.json").write_text(text)
    result = CliRunner().invoke(group, ["status", "--healthy", "--run-dir", str(tmp_path)])
    assert (result.exit_code, result.output.count("\n"), type(result.exception)) == (1, 1, SystemExit)
    assert status_file.main([str(tmp_path)]) == 1


def test_a_lone_surrogate_is_printed_as_a_question_mark(intact: dict[str, Any], tmp_path: Path) -> None:
    """No output can encode it, and PHM itself reports one for a file name that is not UTF-8."""
    document = copy.deepcopy(intact)
    document["checks"][0]["summary"] = "\ud800.bin"
    (tmp_path / "status.json").write_text(json.dumps(document))
    assert status_file.read(str(tmp_path))["checks"][0]["summary"] == "?.bin"
    for fault in document["faults"]["open"]:
        fault["opened"] = "\ud800"
    (tmp_path / "status.json").write_text(json.dumps(document))
    for words in (["status"], ["faults", "--log-dir", str(tmp_path)]):
        answered(CliRunner().invoke(group, [*words, "--run-dir", str(tmp_path)]))


def test_the_damaged_key_is_named(intact: dict[str, Any], tmp_path: Path) -> None:
    """The message has its location in the document, and the expected type."""
    document = copy.deepcopy(intact)
    del document["checks"][0]["slot"]
    (tmp_path / "status.json").write_text(json.dumps(document))
    result = CliRunner().invoke(group, ["status", "--run-dir", str(tmp_path)])
    assert result.exit_code == 1
    assert "is damaged (checks[0].slot is missing)" in result.output


@hypothesis(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_log_line_affects_only_its_own_event(
    data: st.DataObject, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """`phm faults` shows the faults of the other lines, whatever one line contains."""
    folder = tmp_path_factory.mktemp("log")
    record(folder, *RECOVERED, *OPEN)
    file = folder / "log" / "phm.jsonl"
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    hit = data.draw(st.integers(1, len(lines) - 2))
    lines[hit] = damaged(data, lines[hit])
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))
    for more in ([], ["--json"], ["--all"], ["ab12-1"], ["ab12-2"]):
        result = CliRunner().invoke(
            group, ["faults", "--log-dir", str(folder / "log"), "--run-dir", str(folder), *more]
        )
        answered(result)
    assert "ab12-2" in result.output


@pytest.mark.parametrize(
    ("event", "key", "value"),
    [
        ("fault_opened", "unit", ["x"]),
        ("fault_closed", "blocks", [3, {}]),
        ("transition", "unit", {}),
        ("action", "fault", {}),
    ],
)
def test_a_log_line_with_a_value_of_another_type_is_read_without_it(
    event: str, key: str, value: object, tmp_path: Path
) -> None:
    """Everything else is shown."""
    record(tmp_path, *RECOVERED, *OPEN)
    file = tmp_path / "log" / "phm.jsonl"
    lines = [json.loads(line) for line in file.read_text().splitlines()]
    next(line for line in lines if line["event"] == event)[key] = value
    file.write_text("".join(json.dumps(line) + "\n" for line in lines))
    result = CliRunner().invoke(group, ["faults", "--log-dir", str(tmp_path / "log"), "--run-dir", str(tmp_path)])
    assert (result.exit_code, "ab12-2" in result.output) == (0, True), result.exception


def test_a_shape_reports_where_a_document_does_not_match() -> None:
    """Wrong types, missing keys and numbers that are not finite, each with its location; booleans are not numbers."""
    shape = {"a!": [{"n": float}], "t": TableShape(int)}
    assert mismatch({"a": [{"n": 1}, {}], "t": {"x": 1}, "more": object()}, shape) == ""
    assert mismatch({}, shape) == "a is missing"
    assert mismatch({"a": {}}, shape) == "a is not a list"
    assert mismatch({"a": [{}, {"n": float("inf")}]}, shape) == "a[1].n is of the wrong type"
    assert mismatch({"a": [{"n": True}]}, shape) == "a[0].n is of the wrong type"
    assert mismatch({"a": [], "t": {"x": "1"}}, shape) == "t['x'] is of the wrong type"
    assert mismatch([], shape) == "it is not an object"
