"""Syntax errors are reported at the line of the mistake, in plain words."""

from __future__ import annotations

import pytest

from phm.config import ConfigError, loads

STAR = "put text that starts with '*' in quotes"
ESCAPE = r": use single quotes, or '\\' for one backslash"
CASES = {
    "no space after the colon": ("agent: {id: 1}\ninterval:20s\ncontainers: []\n", 2, "the space after it"),
    "no space in a section": ("agent:\n  id: 1\n  name:x\ncontainers: []\n", 3, "the space after it"),
    "no space in the first line": ("interval:20s\ncontainers: []\n", 1, "the space after it"),
    "no space in the first line before a comment": (
        "---\ninterval:20s # often\n\ncontainers: []\n",
        2,
        "the space after it",
    ),
    "no colon in the first line": ("foo\nhost: {}\n", 1, "a ':' is missing after a key"),
    "no colon": ("agent:\n  id: 1\nfoo\nhost: {}\n", 3, "a ':' is missing after a key"),
    "quote to the end": ('agent:\n  name: "a\n  id: 1\nhost: {}\n', 2, "the quote that begins here is not closed"),
    "quote to the next one": (
        "agent:\n  name: 'a\n  id: 1\nhost:\n  x: 'b'\n",
        2,
        "the quote that begins here ends in line 5",
    ),
    "text after a quote": ('agent:\n  name: "a" b\n', 2, "text follows a text in quotes"),
    "key between two levels": (
        "agent:\n    id: 1\n  name: a\n",
        3,
        "check the indentation: it does not fit that of the block that begins in line 1",
    ),
    "key of an entry": ("containers:\n  - name: a\n   recover: true\n", 3, "that begins in line 2"),
    "entry between two levels": ("containers:\n  - name: a\n - name: b\n", 3, "check the indentation"),
    "entry among keys": (
        "containers:\n  - name: a\n    - name: b\n",
        3,
        "an entry of a list is among the keys of the block that begins in line 2",
    ),
    "key among entries": (
        "containers:\n  - name: a\n  recover: true\n",
        3,
        "a key is among the entries of the list that begins in line 2",
    ),
    "first key indented": ("  agent:\n    id: 1\nhost: {}\n", 3, "all keys of the top level begin in the same column"),
    "brace not closed": (
        "agent: {id: 1\nhost:\n  cpu: 1\n",
        1,
        "the '{' is not closed before line 2: a '}' or a ',' is missing",
    ),
    "bracket not closed": ("a: 1\nb: [c, d\n", 2, "the '[' is not closed before line 3"),
    "comma missing": ("agent: {id: 1 name: a}\n", 1, "the '{' is not closed: a '}' or a ',' is missing"),
    "patterns in brackets": ("a: 1\nfiles: [*.mcap, *.log]\n", 2, STAR),
    "second pattern in brackets": ("a: {ignore: [__pycache__, *.pyc]}\n", 1, STAR),
    "pattern as an entry": ("a:\n  - *.pyc\n", 2, STAR),
    "star alone": ("a:\n- *\n", 2, STAR),
    "star alone in brackets": ("a: [*]\n", 1, STAR),
    "pattern of a path": ("a: **/x\n", 1, STAR),
    "ampersand": ("a: &.x\n", 1, "put text that starts with '&' in quotes"),
    "unknown escape": ('a:\n  pattern: "\\d+ frames lost"\n', 2, ESCAPE),
    "unknown escape in brackets": ('a: [b, "\\d+"]\n', 1, ESCAPE),
    "incomplete escape": ('a: [b, "\\xzz"]\n', 1, ESCAPE),
    "one brace too many": ("agent: {id: 1}}\n", 1, "unexpected '}': remove it"),
}


@pytest.mark.parametrize("case", CASES)
def test_a_syntax_error_is_reported_where_the_mistake_is(case: str) -> None:
    text, line, words = CASES[case]
    with pytest.raises(ConfigError) as caught:
        loads(text, "phm.yaml", environ={})
    (problem,) = caught.value.problems
    assert problem.line == line and words in problem.message
    assert "<" not in problem.message and "scalar" not in problem.message
