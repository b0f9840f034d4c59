"""The comparison of quotes with the messages of the code finds each kind of mistake."""

from __future__ import annotations

import ast
import re

import pytest

from tests.docs.messages import CUT, parts_of, problem, unknown
from tests.docs.test_quotes import messages_of_pages, quoted

VERIFIED = "nodes/agent_1/node_1 is OK again 4.2 s after the action began"
DEAD = "A01 FAIL 6 node_1 dead"


@pytest.mark.parametrize(
    "line",
    [
        VERIFIED,
        DEAD,
        f"restart ros_app for: {VERIFIED}",
        "ros_app is on hold until 12:34:05 UTC by operator (uid 0): swapping firmware",
        "configuration reloaded: interval, containers; restart PHM to apply: mavlink",
        "Not all required nodes are running. Missing node: agent_1/node_1 ...",
        "A01 WARN 9 disk / 88 %",
        "A01 OK 6 node_1 restarted",
        "--web 127.0.0.1:8080: Address already in use",
    ],
)
def test_a_message_is_found(line: str) -> None:
    """Also composed of several, cut, as a line of STATUSTEXT, and with a text of the operating system."""
    assert problem(line) == ""


@pytest.mark.parametrize(
    "line",
    [
        "nodes/agent_1/node_1 is OK afterwards 4.2 s after the action began",  # a changed word
        "nodes/agent_1/node_1 is OK 4.2 s after the action began",  # a word is missing
        "nodes/agent_1/node_1 is again OK 4.2 s after the action began",  # another order
        "4.2 s after the action began nodes/agent_1/node_1 is OK again",
        f"{VERIFIED} and after the verification",  # an invented end
        f"{VERIFIED}; nothing else was necessary",
        f"We found that {VERIFIED}",  # an invented beginning
        "nodes/agent_1/node_1 is OK again 4.2 ms after the action began",  # a wrong unit
        "A01 WARN 9 disk / 88%",
        "A01 FAIL 6 node_1 perished",
        "A01 FAILED 6 node_1 dead",  # no word of a line
        "A01 FAIL 16 node_1 dead",  # no slot
        "A01 OK 6 node_1 rebegun",  # no verb
        "SWARM 7/8 FAIL A03:nonsense",
        "Not all required nodes are walking. Missing node: ...",
        "nodes/agent_1/node_1: ros_app",  # values, and no message
        "",
    ],
)
def test_a_planted_mistake_is_found(line: str) -> None:
    """Each of these resembles a message."""
    assert problem(line) != ""


def changed() -> list[str]:
    """Each quote of the documents with its longest plain word exchanged."""
    found = []
    for line in (*(quote for _, quote in messages_of_pages()), *(message for _, _, message in quoted())):
        plain = re.findall(r"(?<![\w/.'-])[a-z]{3,}(?![\w/.'-])", line)
        if plain and len(line.split()) < 20:
            found.append(re.sub(rf"\b{max(plain, key=len)}\b", "bananas", line))
    return found


@pytest.mark.parametrize("line", changed())
def test_no_word_of_the_documents_may_be_exchanged(line: str) -> None:
    """A changed word in a quote is found, wherever it is."""
    assert problem(line) and problem(f"{line} {CUT}")


def test_the_time_grows_with_the_length_of_a_line() -> None:
    """A line of 200 words that resembles many messages is compared at all, with and without mistakes."""
    line = "; ".join([VERIFIED] * 20)
    assert problem(line) == "" and problem(line.replace("again", "afterwards")) != ""


def test_the_parts_of_a_message() -> None:
    """Neighbouring texts and values are one; formats are values; blanks are one."""
    parsed = ast.parse("""f"{a}{b}  is " + 'the {c} of ' 'it' + x""", mode="eval")
    assert parts_of(parsed.body) == (None, " is the ", None, " of it", None)


def test_what_a_value_consists_of() -> None:
    """A word of the code, a number with its unit, parentheses, and lists; not a sentence."""
    assert unknown("agent_1/node_1") == unknown("4.2 s") == unknown("health, network and restart") == 0
    assert unknown("ros_app (node_3)") == unknown("A01 A02 +5") == 0
    assert unknown("bananas") == 1 and unknown("restart the container") == 2 and unknown("99%") == 1
