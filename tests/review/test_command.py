"""`phm report` on the command line: formats, exit codes, sentences for what is wrong."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from phm.cli import group
from phm.core.model import Level, Transition
from tests.review.records import Flown, Ground
from tests.review.test_document import one_flight


def phm(*words: object) -> Result:
    return CliRunner().invoke(group, ["report", *map(str, words)], env={"COLUMNS": "200"})


def test_the_default_are_sentences_and_tables(tmp_path: Path) -> None:
    """The first lines are the five sentences."""
    one_flight(tmp_path).close()
    result = phm(tmp_path)
    assert result.exit_code == 0
    assert result.output.startswith("The record lasted 8 min 20 s")
    assert "nodes/node_1" in result.output and "by restart" in result.output


def test_json_csv_and_markdown_have_the_same_faults(tmp_path: Path) -> None:
    """One document, three forms."""
    one_flight(tmp_path).close()
    faults = json.loads(phm(tmp_path, "--json").output)["faults"]
    rows = list(csv.DictReader(io.StringIO(phm(tmp_path, "--csv").output)))
    assert [row["fault"] for row in rows] == [fault["fault"] for fault in faults]
    assert float(rows[0]["lasted_s"]) == faults[0]["lasted_s"]
    markdown = phm(tmp_path, "--markdown").output
    assert "| agent\\_1 |" in markdown and "nodes/node\\_1" in markdown


def test_flights_are_listed_so_that_one_can_be_chosen(tmp_path: Path) -> None:
    """With the number that `--flight` takes, when it began, how long it was, and who flew; on the terminal and in Markdown."""
    made = one_flight(tmp_path)
    made.arm(True)
    made.until(530)
    made.arm(False)
    made.close()
    shown = phm(tmp_path).output
    assert "Flights" in shown and "and 2 flights" in shown
    rows = [line.split() for line in shown.splitlines() if line.endswith(" agent_1")]
    assert [(row[0], row[2][:8]) for row in rows] == [("1", "12:01:40"), ("2", "12:08:20")]
    assert "| 2 | 2026-03-01 12:08:20.000 | 30 s | agent\\_1 |" in phm(tmp_path, "--markdown").output
    chosen = phm(tmp_path, "--flight", 2).output
    assert chosen.startswith("Flight 2 lasted 30 s") and "Flights" in chosen


def test_many_agents_of_a_flight_are_counted(tmp_path: Path) -> None:
    """The row of a flight stays one line."""
    for number in range(1, 9):
        made = Flown(tmp_path / str(number), number)
        made.arm(True)
        made.until(30)
        made.arm(False)
        made.close()
    assert "agent_1, agent_2, agent_3, agent_4, agent_5 and 3 more" in phm(tmp_path).output


def test_phm_itself_and_what_was_not_known_are_in_every_output(tmp_path: Path) -> None:
    """They are facts of the flight, and not of the page alone."""
    made = Flown(tmp_path)
    made.until(40)
    made.log.handle(Transition(made.at, Level.OK, made._state("rates/topic_1", Level.STALE, "no answer")))
    made.until(60)
    made.log.handle(Transition(made.at, Level.STALE, made._state("rates/topic_1", Level.OK)))
    made.until(100)
    made.close()
    terminal, markdown = phm(tmp_path).output, phm(tmp_path, "--markdown").output
    for title in ("PHM itself", "What was not known"):
        assert title in terminal and f"## {title}" in markdown
    assert "| agent\\_1 | rates/topic\\_1 | 20 s | 0.0 s |" in markdown
    itself = markdown.partition("## PHM itself")[2].partition("##")[0].splitlines()
    head, row = itself[2].split(" | "), itself[4].split(" | ")
    figures = dict(zip(head, row, strict=True))
    assert (figures["ran"], figures["restarts"], figures["reports"]) == ("100.00 %", "0", "5")
    assert figures["report takes"].endswith(" s") and figures["CPU"].endswith(" %")


def test_lines_that_the_log_lacks_are_in_a_table(tmp_path: Path) -> None:
    """A gap of the numbers does not read like a quiet time."""
    log = one_flight(tmp_path).close()
    lines = log.read_bytes().splitlines(keepends=True)
    log.write_bytes(b"".join(lines[:30] + lines[41:]))
    assert "| agent\\_1 | lines that are missing in the logs | 11 |" in phm(tmp_path, "--markdown").output


def test_text_of_a_record_is_neither_formula_nor_markdown(tmp_path: Path) -> None:
    """A summary is hostile: a spreadsheet does not calculate it, Markdown does not link it."""
    made = Flown(tmp_path)
    made.until(20)
    made.fail("nodes/node_1", brief="=HYPERLINK(1) <img> [x](y)|")
    made.until(60)
    made.close()
    assert "'=HYPERLINK" in phm(tmp_path, "--csv").output
    markdown = phm(tmp_path, "--markdown").output
    assert "&lt;img&gt; \\[x\\](y)\\|" in markdown and "<img>" not in markdown


def test_text_of_a_record_does_not_steer_the_terminal(tmp_path: Path) -> None:
    """An escape sequence can hide lines, or write to the clipboard."""
    escape = "\x1b]52;c;cHduZWQ=\x1b\\"
    made = Flown(tmp_path)
    made.until(20)
    made.fail("nodes/node_1", brief=f"dead{escape}")
    made.until(60)
    made.close()
    for words in (["."], [".", "--csv"], [".", "--markdown"], ["--compare", ".", "."]):
        shown = phm(*[tmp_path if word == "." else word for word in words])
        assert "\x1b" not in shown.output
    assert "dead\\x1b]52" in phm(tmp_path).output


def test_flights_are_compared_by_their_numbers(tmp_path: Path) -> None:
    """`PATH#N` is one flight of a record."""
    one_flight(tmp_path / "a").close()
    one_flight(tmp_path / "b").close()
    result = phm("--compare", f"{tmp_path / 'a'}#1", tmp_path / "b", "--json")
    made = json.loads(result.output)
    assert (made["a"]["window"]["flight"], made["b"]["window"]["flight"]) == (1, None)
    assert "A: flight 1, 3 min 20 s" in phm("--compare", f"{tmp_path / 'a'}#1", tmp_path / "b").output


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["missing"], 1, "missing does not exist"),
        (["."], 1, "no record in ."),
        ([".", "--json", "--csv"], 2, "choose one of --json"),
        ([".", "--compare"], 2, "--compare takes two PATHs"),
        ([], 2, "Missing argument"),
    ],
)
def test_each_error_is_one_sentence_with_its_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], code: int, text: str
) -> None:
    """With the exit code of the documents and no traceback."""
    monkeypatch.chdir(tmp_path)
    result = phm(*words)
    assert (result.exit_code, isinstance(result.exception, SystemExit)) == (code, True)
    assert text in result.output


@pytest.mark.extras
@pytest.mark.parametrize(
    ("data", "text"),
    [(b"", "the files are empty"), (b"garbage\n", "phm.jsonl:1: not JSON"), (b'{"a": 1}\n', "no line of a record")],
)
def test_a_file_without_a_line_of_a_record_does_not_read_like_a_flight(tmp_path: Path, data: bytes, text: str) -> None:
    """It is an error in every output: nothing read must not look like nothing failed."""
    (tmp_path / "phm.jsonl").write_bytes(data)
    for words in ([], ["--json"], ["--html", tmp_path / "page.html"], ["--parquet", tmp_path / "set"]):
        result = phm(tmp_path, *words)
        assert (result.exit_code, result.stdout) == (1, "")
        assert "no line of a record in" in result.stderr and text in result.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == ["phm.jsonl"]


def test_a_ground_that_received_no_agent_does_not_read_like_a_flight_without_faults(tmp_path: Path) -> None:
    """What is not known is called unknown, and the advice is not to go on."""
    ground = Ground(tmp_path / "ground.jsonl")
    ground.event(1, "link", link="udpin:127.0.0.1:14551", open=True, error="")
    ground.close()
    result = phm(tmp_path)
    assert result.exit_code == 0
    assert "Faults are unknown: no agent is in the record." in result.output
    assert "no fault." not in result.output and "Nothing in the record" not in result.output
    assert len(json.loads(phm(tmp_path, "--json").output)["sentences"]) == 5


def test_an_unknown_flight_is_an_error_that_lists_the_known_ones(tmp_path: Path) -> None:
    """So that the next call is right."""
    one_flight(tmp_path).close()
    result = phm(tmp_path, "--flight", 3)
    assert result.exit_code == 1
    assert "flight 3 is not in the record: it has flights 1 (3 min 20 s)" in result.output


def test_a_missing_package_is_named_with_the_extra(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is read before that is known."""
    monkeypatch.setattr("phm.cli.report.find_spec", lambda name: None if name == "duckdb" else object())
    result = phm(tmp_path, "--parquet", tmp_path / "set")
    assert result.exit_code == 1
    assert "phm report needs duckdb: install the extra 'report'" in result.output
