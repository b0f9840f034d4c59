"""Log lines, outputs and messages that the documents quote are messages of the code (`tests.docs.messages`)."""

from __future__ import annotations

import re

import pytest

from phm.reporters.text_log_format import NOTE_KINDS
from tests.docs.blocks import FENCE, blocks
from tests.docs.examples import ROOT, pages
from tests.docs.messages import CUT, problem
from tests.docs.test_commands import FOREIGN

WALKED = "docs/guides/write-a-check.md"
"""Its commands are run by `test_walk.py`, which compares the output with the real one. Its messages are those of its check."""
KINDS = {*NOTE_KINDS, "SUCCESS", "BYPASS", "WARNING", "FAILURE", "STALE", "RESOLVED", "ESCALATED"}
LOG_LINE = re.compile(r"^(?:[\d-]+ [\d:.]+ ---- )?([A-Z]{3,}): (?:\(\d+\) )?(.*)$")
INLINE = re.compile(r"(?<!`)`([^`]+)`(?!`)")
WORDS = 3
"""A quote in a sentence has this many words; fewer are names, and have their own tests."""
NO_MESSAGE = re.compile(
    r"""
    .*[{}=*<>|]                                # code, settings, JSON, a form with places to fill in
    | .*\ --?\w | --[\w-]+(?:\ [A-Z:]+)+$      # options
    | [\w.]+:\ "                               # a key and its value
    | \[\d                                     # a list
    | (?:set|long)\ \w+\ \d                    # commands of MAVProxy
    """,
    re.VERBOSE,
)
PROGRAMS = FOREIGN | {"phm", "python", "openssl"}
FOREIGN_TEXT = {
    "This Fast DDS version doesn't have the security libraries": "Fast DDS",
    "Detected vehicle 7:193": "MAVProxy",
    "link 1 down": "MAVProxy",
    "online system 7": "MAVProxy",
    "online system N": "MAVProxy",
}
"""Quoted texts of other programs, with their names."""
ELSEWHERE = {
    "GCS CON FIL NET DEV NOD TOP RAT HST AUT RAD PEE US1 US2 US3": "columns of `phm gcs`",
    "12345678 9012 345": "places in a column of `phm gcs`",
    "YYYY-MM-DD HH:MM:SS.mmm ---- KIND: (slot) message": "the form of a log line, compared by tests/reporters",
    "tcp: A TCP server accepts connections": "a choice of the page: a type, and the first sentence of its settings",
    "1 ros_app, 2 router": "names with their numbers",
    "yes, 1.4 s": "a cell of the table below it",
    "MAV.doCommand(5, 193, MAVLink.MAV_CMD.USER_1, 2, 17, 0, 0, 0, 0, 0)": "code of Mission Planner",
    "Authorization: Bearer TOKEN": "a header of HTTP",
    "403 METHOD PATH": "the log of HAProxy",
    "(phm_actions_total unless phm_actions_total offset 1h) or increase(phm_actions_total[1h])": "a query of Prometheus",
}
"""What is in backticks without being a message, with its reason."""
AROUND = re.compile(r"^(?:SRC=1/193:|\[mavlink: component 193\] |193 : )")
"""What autopilots and MAVProxy put before PHM's line."""


def quoted() -> list[tuple[str, str, str]]:
    """(place, kind, message) of each log line in blocks that are not generated."""
    found = []
    for block in blocks("text", "console"):
        if not block.generated and block.page != WALKED:
            matches = filter(None, map(LOG_LINE.match, block.text.splitlines()))
            found += [(str(block), match[1], match[2]) for match in matches]
    return found


@pytest.mark.parametrize(("place", "kind", "message"), quoted())
def test_a_quoted_log_line_is_a_message_of_the_code(place: str, kind: str, message: str) -> None:
    """Its kind exists, and so do all parts of its message."""
    assert kind in KINDS, place
    assert not problem(message), f"{place}: {problem(message)}"


def outputs() -> list[tuple[str, str]]:
    """Each line of output in a console block that is not generated."""
    found = []
    for block in blocks("console"):
        if not block.generated and block.page != WALKED:
            lines = [line for line in block.text.splitlines() if line.strip() and not line.startswith("$ ")]
            found += [(str(block), line) for line in lines]
    return found


@pytest.mark.parametrize(("place", "line"), outputs())
def test_an_output_is_a_message_of_the_code(place: str, line: str) -> None:
    """A line that a console block shows is a message of the code; single numbers are exit codes."""
    assert line.strip().isdecimal() or not problem(line), f"{place}: {problem(line)}"


def inline(text: str) -> list[tuple[int, str]]:
    """(line, quote) of each message in the sentences and tables of a page."""
    sentences = FENCE.sub(lambda block: "\n" * block[0].count("\n"), text)
    found = []
    for match in INLINE.finditer(sentences):
        quote = AROUND.sub("", " ".join(match[1].split()))
        words = quote.split()
        if len(words) >= WORDS and not NO_MESSAGE.match(quote) and words[0] not in PROGRAMS and "/" not in words[0]:
            found.append((sentences.count("\n", 0, match.start()) + 1, quote))
    return found


def messages_of_pages() -> list[tuple[str, str]]:
    """(place, quote) of each message in a sentence or table, without the known texts of others."""
    found = []
    for page in pages():
        name = str(page.relative_to(ROOT))
        if name != WALKED:
            found += [(f"{name}:{line}", quote) for line, quote in inline(page.read_text("utf-8"))]
    return [(place, quote) for place, quote in found if quote not in FOREIGN_TEXT and quote not in ELSEWHERE]


@pytest.mark.parametrize(("place", "quote"), messages_of_pages())
def test_a_message_in_a_sentence_is_one_of_the_code(place: str, quote: str) -> None:
    """All of it, or its beginning."""
    assert not problem(quote) or not problem(f"{quote} {CUT}"), f"{place}: {problem(quote)}"


@pytest.mark.parametrize("quote", [*FOREIGN_TEXT, *ELSEWHERE])
def test_an_exception_is_quoted(quote: str) -> None:
    """A text that is gone from the documents needs no exception."""
    assert any(quote == found for page in pages() for _, found in inline(page.read_text("utf-8"))), quote
