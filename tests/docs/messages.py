"""Whether a line that a document quotes is a message of the code: compared part by part.

A message of the code is a list of literal parts with places for inserted values between them. A line is such a message when
all its literal parts are in the line, in their order, and between them short values or other messages. Messages may follow
one another after SEPARATORS, and a message that begins with an inserted value may go on where another ends, as the code
composes them: `f"{summary}; blocks {units}"`. Each position of a line is decided once for each message, so the time grows
with the length of the line.
"""

from __future__ import annotations

import ast
import errno
import heapq
import os
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from functools import cache

from phm.core.settings import Settings
from phm.gcs.statustext_parser import LineKind, parse
from tests.docs.examples import ROOT

SHARE = 0.95
"""The part of a line's words that must be literal in the code, or of a form that values have (`unknown`).

The rest is for what comes from outside, such as the text of another program. A line of up to 19 words has no room for any.
"""
VALUE_CHARS = 60
"""An inserted value is not longer; what is longer is a message, and compared as one."""
LETTERS = 4
"""Letters and digits of a message before the place where a quote breaks off."""
CUT = "..."
"""In a quote: the rest of a message is not quoted, or any value."""
SEPARATORS = (": ", "; ", ", ", ". ")
JOINED = {"brief": (" ",), "_line": (" ", "")}
"""Functions of the code that put their texts one after the other, and what is between these."""
STATUSTEXT = re.compile(r"A\d\d+ |SWARM ")
OF_OPERATORS = ("new firmware", "propeller 3 replaced", "swapping firmware")
"""What operators of the documents give as a reason (`--reason`) or note (`phm note`)."""
WORD = re.compile(r"[A-Za-z][A-Za-z0-9_-]*:?")
NUMBER = re.compile(r"[^\w%]*\d[\d.:]*")
ARRAY = re.compile(r"[01-]{8}")
AGENT = re.compile(r"\+?A?\d")
FIELD = re.compile(r"\{[^{}]*\}|%[-.\d]*[sdrf]")
VALUE = re.compile(
    r"""
    [^\w%]*\d[\w.:+/-]*[^\w%]*    # a number, a time, a version
    | \W*\w*[/_.@#=][\w/].*          # a path, a unit of PHM, an address
    | .*\.\.\.\W*                 # cut by the document
    | [^\w%]*\w*\d\w*[^\w%]*      # a name with a number: A07, ttyUSB0
    | --[a-z-]+                   # an option
    | \W*[A-Z][A-Z0-9_-]*\W*      # a name in capitals
    | ['"]\S*|\S*['"]             # the beginning or end of something quoted
    | [^\w\s]+                    # a sign
    """,
    re.VERBOSE,
)

Parts = tuple["str | None", ...]
"""Literal texts, and None for each inserted value."""


@cache
def words() -> frozenset[str]:
    """Strings of the code that are one word: levels, conditions, actions, layers; and the sections of the configuration."""
    found = (text.removesuffix(":").lower() for text in texts() if WORD.fullmatch(text))
    return frozenset((*found, *Settings.model_fields))


@cache
def messages() -> frozenset[Parts]:
    """All messages of the code that have a word, and those of the operating system for errors of a call."""
    errors = ((os.strerror(number),) for number in errno.errorcode)
    return frozenset(filter(_says, (*errors, *_code()[1])))


def texts() -> frozenset[str]:
    """All strings of PHM, also the literal parts of f-strings; without what only explains the code."""
    return _code()[0]


@cache
def _code() -> tuple[frozenset[str], frozenset[Parts]]:
    """Strings and messages of PHM's modules. No tree is kept: all of them are 700 000 objects, a load for each later garbage collection."""
    found: tuple[set[str], set[Parts]] = (set(), set())
    for folder in ("phm", "checks", "sitl"):
        for path in (ROOT / folder).rglob("*.py"):
            _take(ast.parse(path.read_text("utf-8")), *found)
    return frozenset(found[0]), frozenset(found[1])


def _take(tree: ast.AST, strings: set[str], found: set[Parts]) -> None:
    """Add the strings and the messages in a tree; the literal parts of an f-string are no messages by themselves."""
    waiting = [tree]
    while waiting:
        for node in ast.iter_child_nodes(waiting.pop()):
            if isinstance(node, ast.JoinedStr | ast.Constant | ast.BinOp):
                found.add(parts_of(node))
            if isinstance(node, ast.JoinedStr):
                strings.update(filter(None, map(_text, node.values)))
                waiting += [part for part in node.values if isinstance(part, ast.FormattedValue)]
            elif isinstance(node, ast.Constant):
                strings.add(_text(node))
            elif not _explains(node):
                found.update(_joined(node))
                waiting.append(node)


def _explains(node: ast.AST) -> bool:
    """Whether it is a docstring, or a sentence below a constant: what explains the code is not printed by it."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _text(node: ast.AST) -> str:
    """Of a string of the code; empty for anything else."""
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


def _joined(node: ast.AST) -> Iterator[Parts]:
    """The message that a call of JOINED composes."""
    if isinstance(node, ast.Call) and (between := JOINED.get(_name(node))):
        given = zip(node.args, (*between, ""), strict=False)
        yield _merged(part for text, blank in given for part in (*parts_of(text), blank))


def _name(call: ast.Call) -> str:
    return call.func.id if isinstance(call.func, ast.Name) else ""


def parts_of(node: ast.expr) -> Parts:
    """The parts of a text of the code; anything else is an inserted value."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        literal, *more = FIELD.split(node.value)
        return _merged((literal, *(part for text in more for part in (None, text))))
    if isinstance(node, ast.JoinedStr):
        return _merged(str(part.value) if isinstance(part, ast.Constant) else None for part in node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return _merged((*parts_of(node.left), *parts_of(node.right)))
    return (None,)


def _merged(parts: Iterable[str | None]) -> Parts:
    """Neighbouring texts as one, neighbouring values as one, and one blank for many."""
    found: list[str | None] = []
    for part in parts:
        if part == "":
            continue
        if found and isinstance(part, str) and isinstance(found[-1], str):
            found[-1] += part
        elif not found or part is not None or found[-1] is not None:
            found.append(part)
    return tuple(part if part is None else re.sub(r"\s+", " ", part) for part in found)


def _says(parts: Parts) -> bool:
    """Whether there is a word in it, and more than one word in all."""
    literal = "".join(part or "0" for part in parts).strip()
    return " " in literal and re.search(r"[A-Za-z]{2}", literal) is not None


def problem(quote: str) -> str:
    """Why the quote is not a message of the code, or an empty string. A full stop at its end may be of the document.

    `phm gcs` puts a question mark after a cause that is only likely.
    """
    text = " ".join(quote.split())
    for reason in OF_OPERATORS:
        text = text.replace(reason, "REASON")
    text = text if text.endswith(CUT) else text.rstrip(".?")
    found = _Line(text).problem()
    subject, _, rest = text.partition(" ")
    if found and STATUSTEXT.match(text):
        return _problem_of_statustext(text)
    return _Line(rest).problem() if found and VALUE.fullmatch(subject) and " " in rest else found


def _problem_of_statustext(text: str) -> str:
    """As `phm.wire.status_line` composes it: agent, word and slot, then the brief of a result. The ground's parser takes it apart."""
    line = parse(text)
    if line is None:
        return f"{text!r} is not a line that the ground can read"
    said = line.recovered or line.text
    if line.kind is LineKind.SWARM or " " not in said:
        return "" if all(map(known, said.split())) else f"{text!r} has a word that is not in the code"
    subject, _, rest = said.partition(" ")
    if rest in words() and known(subject):
        return ""
    return _Line(said).problem() and (_Line(rest).problem() if known(subject) else f"{subject!r} is not in the code")


Ends = dict[int, int]
"""How many words are of no known form up to each place in the line, at best."""


@dataclass
class _Line:
    """A quoted line; positions in it are those of its characters."""

    text: str
    _chains: dict[int, Ends] = field(default_factory=dict)
    _fills: dict[int, Ends] = field(default_factory=dict)
    _known_ends: dict[tuple[Parts, int], Ends] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._cuts = [cut.start() for cut in re.finditer(re.escape(CUT), self.text)]
        # (where the text before it ends, where it ends) of each cut that something is before, with and without the blank between.
        before = {(end, cut + len(CUT)) for cut in self._cuts for end in (cut, len(self.text[:cut].rstrip())) if end}
        self._broken_off = sorted(before)
        self._prefixes: dict[str, list[tuple[int, int, int]]] = {}
        # By place: the messages whose first literal part is there, that begin with it or with a value.
        self._beginning: dict[int, list[Parts]] = defaultdict(list)
        self._continuing: dict[int, list[Parts]] = defaultdict(list)
        for parts in filter(self._may_have, messages()):
            found, rest = (self._beginning, parts) if parts[0] is not None else (self._continuing, parts[1:])
            for at in self._places(rest[0] or ""):
                found[at].append(rest)

    def problem(self) -> str:
        found = self._chain(0).get(len(self.text))
        if found is None:
            return f"{self.text!r} is not a message of the code, nor several of them"
        known = 1 - found / len(self.text.split())
        return "" if known >= SHARE else f"{found} words of {self.text!r} are not in the code, and no values"

    def _may_have(self, parts: Parts) -> bool:
        """A quick look: its literal parts are in the line, in their order, where the line is not cut."""
        at = 0
        for number, part in enumerate(parts):
            if part is not None:
                at = self.text.find(part, at)
                if at < 0:
                    return bool(self._cuts) and (number > 1 or bool(self._cut_parts(part, LETTERS)))
                at += len(part)
        return True

    def _places(self, part: str) -> set[int]:
        """Where a first literal part is in the line, or its beginning is before a cut."""
        found = {begin for begin, _ in self._cut_parts(part, LETTERS)}
        at = self.text.find(part)
        while at >= 0:
            found.add(at)
            at = self.text.find(part, at + 1)
        return found

    def _cut_parts(self, part: str, least: int) -> list[tuple[int, int]]:
        """(where it begins, where the cut ends) of each place where the line breaks off in a literal part."""
        if part not in self._prefixes:
            self._prefixes[part] = [
                (before - size, end, len(re.findall(r"\w", part[:size])))
                for before, end in self._broken_off
                for size in self._sizes(part, before)
            ]
        return [(begin, end) for begin, end, letters in self._prefixes[part] if letters >= least]

    def _sizes(self, part: str, before: int) -> Iterator[int]:
        """The lengths of beginnings of a part which the text has before this place. Compared only where the last character is equal:
        a comparison for each length took half of the time of these tests."""
        last = self.text[before - 1]
        size = part.find(last) + 1
        while 0 < size <= before:
            if self.text.startswith(part[:size], before - size):
                yield size
            size = part.find(last, size) + 1

    def _chain(self, start: int) -> Ends:
        """Where messages that begin here, one after the other, end."""
        if start not in self._chains:
            self._chains[start] = self._linked(start)
        return self._chains[start]

    def _linked(self, start: int) -> Ends:
        """Places are taken from left to right; `said`: a message has been found, not only values."""
        best: dict[_Place, int] = {(start, False, False): 0}
        waiting: list[_Place] = [*best]
        while waiting:
            place = heapq.heappop(waiting)
            for (at, ended, said), more in self._next(place):
                known = best.get((at, ended, said))
                if known is None:
                    heapq.heappush(waiting, (at, ended, said))
                if known is None or best[place] + more < known:
                    best[at, ended, said] = best[place] + more
        return {at: cost for (at, ended, said), cost in best.items() if ended and said}

    def _next(self, place: _Place) -> Iterator[tuple[_Place, int]]:
        at, ended, said = place
        if ended:
            for separator in SEPARATORS:
                if self.text.startswith(separator, at):
                    yield (at + len(separator), False, said), 0
            joined = [parts for parts in self._beginning.get(at, ()) if not self.text[at].isalnum()]
            for parts in (*joined, *self._continuing.get(at, ())):
                yield from (((end, True, True), cost) for end, cost in self._ends(parts, at).items())
            return
        for parts in self._beginning.get(at, ()):
            yield from (((end, True, True), cost) for end, cost in self._ends(parts, at).items())
        values = self._values(at)
        for begin, unknown in values.items():
            for parts in self._continuing.get(begin, ()):
                yield from (((end, True, True), unknown + cost) for end, cost in self._ends(parts, begin).items())
        yield from (((end, True, said), cost) for end, cost in values.items() if end > at and self._at_end(end))

    def _at_end(self, at: int) -> bool:
        return at == len(self.text) or self.text[at] in " ,;:."

    def _ends(self, parts: Parts, start: int) -> Ends:
        """Where a message ends whose first literal part begins here."""
        if (parts, start) not in self._known_ends:
            self._known_ends[parts, start] = self._matched(parts, {start: 0})
        return self._known_ends[parts, start]

    def _matched(self, parts: Parts, states: Ends) -> Ends:
        done: Ends = {}
        inserted, letters = False, 0
        for part in parts:
            inserted = part is None
            if part is None:
                states = self._filled(states)
                if letters >= LETTERS and self._cuts:
                    _add(done, {end: cost for end, cost in states.items() if self.text[:end].endswith(CUT)})
                continue
            for begin, end in self._cut_parts(part, 0 if letters >= LETTERS else LETTERS):
                if begin in states:
                    _add(done, {end: states[begin]})
            letters += len(re.findall(r"\w", part))
            states = {at + len(part): cost for at, cost in states.items() if self.text.startswith(part, at)}
            if not states:
                break
        if inserted:
            states = {at: cost for at, cost in states.items() if self._at_end(at)}
        return _add(done, states)

    def _filled(self, starts: Ends) -> Ends:
        """Where an inserted value, or messages in its place, end."""
        found: Ends = {}
        for at, cost in starts.items():
            begins = not (self.text[at - 1 : at].isalnum() and self.text[at : at + 1].isalnum())
            for ends in (self._values(at), self._chain(at) if begins else {}):
                _add(found, {end: cost + more for end, more in ends.items()})
        return found

    def _values(self, start: int) -> Ends:
        if start not in self._fills:
            ends = range(start, min(len(self.text), start + VALUE_CHARS) + 1)
            self._fills[start] = {end: unknown(self.text[start:end]) for end in ends}
        return self._fills[start]


_Place = tuple[int, bool, bool]
"""The place, whether a message ends there or begins, and whether there was one."""


def _add(found: Ends, more: Ends) -> Ends:
    for at, cost in more.items():
        found[at] = min(cost, found.get(at, cost))
    return found


def unknown(value: str) -> int:
    """How many words of an inserted value are not what a value consists of.

    A value is one known word, a number with its unit, something in parentheses, or a list of these.
    """
    found, more, inside, before = 0, True, False, ""
    for word in value.split():
        inside = inside or word.startswith("(")
        unit = (
            NUMBER.fullmatch(before) is not None or (AGENT.match(before) and AGENT.match(word)) or ARRAY.fullmatch(word)
        )
        listed = more or inside or unit or word.startswith(CUT)
        found += word != "and" and not (listed and known(word))
        inside = inside and ")" not in word
        more = word.endswith((",", ":")) or word.startswith("--") or word in ("and", "%")
        before = word
    return found


def known(word: str) -> bool:
    """Whether a word has the form of a value, or is one of the code."""
    bare = word.strip("\"'()[],.;:").lower()
    named = not bare or bare in words() or VALUE.fullmatch(word) is not None
    return named or (":" in bare and all(map(known, bare.split(":"))))
