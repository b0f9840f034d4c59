"""Parses the lines that PHM sends to the ground (`phm.wire.status_line`, `phm.swarm.digest`). Pure."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum

from phm.core.model import Level
from phm.wire.status_line import PAST_VERBS

_AGENT = r"A(?P<agent>0[1-9]|[1-9][0-9]{1,2})"
_REFRESH = re.compile(
    rf"{_AGENT} (?P<word>FAIL|WARN|OK|STALE|HOLD) (?P<array>[01-]{{8}})(?: (?P<slot>[0-9]{{1,2}})(?: (?P<text>.+))?)?"
)
_CHANGE = re.compile(
    rf"{_AGENT} (?P<word>FAIL|WARN|OK|HOLD|ADVISE|APPROVED|EXPIRED|GAVE UP) (?P<slot>[0-9]{{1,2}})(?: (?P<text>.+))?"
)
_RELAY = re.compile(rf"{_AGENT} (?P<text>no GCS radio[,:] .*)")
_SWARM = re.compile(r"SWARM (?P<healthy>[0-9]{1,3})/(?P<members>[0-9]{1,3}) (?P<word>OK|WARN|FAIL)(?: (?P<text>.+))?")
_VERB = rf"(?:{'|'.join(PAST_VERBS.values())}|fixed by \S{{1,12}})"
_RECOVERED = re.compile(rf"{_VERB}: (?P<brief>.+)|(?P<subject>\S+) {_VERB}")
_ADVICE = re.compile(r"(?P<action>\S+) (?P<target>.*?) ?#(?P<fault>[0-9]{1,9})(?: (?P<valid_s>[0-9]{1,4})s)?")
_FAULT = re.compile(r" ?#([0-9]{1,9})$")
_REQUEST = re.compile(rf"(?:{'|'.join(filter(None, PAST_VERBS))}) (?:failed|refused): ")
"""The result of an operator's request, which is not the state of a unit."""
_MORE = re.compile(r" \+[0-9]+$")
_NAMED = re.compile(r"A([0-9]{2,3}):")
LEVELS = {"FAIL": Level.ERROR, "GAVE UP": Level.ERROR, "WARN": Level.WARN}


class LineKind(str, Enum):
    """REFRESH repeats the status of the agent; RELAY is about an agent that does not reach the ground."""

    CHANGE = "change"
    REFRESH = "refresh"
    RELAY = "relay"
    SWARM = "swarm"


@dataclass(frozen=True, slots=True)
class ParsedAdvice:
    """fault: its number. valid_s: how long an approval is valid, None: the line does not say it."""

    fault: int
    action: str
    target: str
    valid_s: float | None


@dataclass(frozen=True, slots=True)
class ParsedLine:
    """agent: the agent that it is about, 0 for the swarm. slot: 0 if the line has none. text: the rest of the line."""

    kind: LineKind
    agent: int
    word: str
    slot: int
    text: str
    alone: bool = False
    """A refresh that reports one failing unit and no more."""
    array: str = ""
    """The digits of a refresh, slots 1 to 8."""

    @property
    def level(self) -> Level | None:
        """The level that it reports for a unit: ERROR or WARN, else None."""
        if self.kind is LineKind.CHANGE and self.word == "WARN" and _REQUEST.match(self.text):
            return None
        return LEVELS.get(self.word) if self.kind in (LineKind.CHANGE, LineKind.REFRESH) and self.text else None

    @property
    def failure(self) -> str:
        """The text of the failure, without the number that only GAVE UP adds."""
        return _FAULT.sub("", self.text) if self.word == "GAVE UP" else self.text

    def is_about(self, text: str) -> bool:
        """Whether it reports the failure that an earlier line reported with `text`; GAVE UP may have the target before it."""
        rest = self.failure.partition(": ")[2] if self.word == "GAVE UP" else ""
        return matches(text, self.failure) or matches(text, rest)

    @property
    def advice(self) -> ParsedAdvice | None:
        """The action that waits for an approval; None if the line does not ask for one."""
        match = _ADVICE.fullmatch(self.text) if self.word == "ADVISE" else None
        if match is None:
            return None
        valid_s = float(match["valid_s"]) if match["valid_s"] else None
        return ParsedAdvice(int(match["fault"]), match["action"], match["target"], valid_s)

    @property
    def fault(self) -> int | None:
        """The number of the fault with which the line ends."""
        match = _FAULT.search(self.text)
        return int(match[1]) if match else None

    @property
    def recovered(self) -> str:
        """The failure that ended, or the name of its unit; empty if the line does not report the end of one."""
        match = self._recovered()
        return (match["brief"] or match["subject"]) if match else ""

    def resolves(self, text: str) -> bool:
        """Whether the line reports the end of the failure that an earlier line reported with `text`."""
        match = self._recovered()
        if match is None:
            return False
        if match["brief"]:
            return matches(text, match["brief"])
        head, dots, _ = text.partition("..")
        return text.startswith(f"{match['subject']} ") or bool(dots and match["subject"].startswith(head))

    def _recovered(self) -> re.Match[str] | None:
        return _RECOVERED.fullmatch(self.text) if self.kind is LineKind.CHANGE and self.word == "OK" else None


def parse(text: str) -> ParsedLine | None:
    """The parsed line; None: it is not a line of PHM."""
    for kind, form in (
        (LineKind.REFRESH, _REFRESH),
        (LineKind.CHANGE, _CHANGE),
        (LineKind.RELAY, _RELAY),
        (LineKind.SWARM, _SWARM),
    ):
        match = form.fullmatch(text)
        if match is None:
            continue
        found = match.groupdict()
        agent, slot = int(found.get("agent") or 0), int(found.get("slot") or 0)
        if (
            agent > 250
            or slot > 15
            or (kind is not LineKind.SWARM and agent < 1)
            or (found.get("slot") is not None and slot < 1)
        ):
            return None
        word, rest = found.get("word") or "", found.get("text") or ""
        if kind is LineKind.REFRESH:
            alone = word in LEVELS and not _MORE.search(rest)
            return ParsedLine(kind, agent, word, slot, _MORE.sub("", rest), alone, found["array"])
        return ParsedLine(kind, agent, word, slot, rest)
    return None


def unhealthy_agents(line: ParsedLine) -> frozenset[int] | None:
    """The agents that are not OK by a SWARM line; None if it had no room for all."""
    if _MORE.search(f" {line.text}"):
        return None
    return frozenset(int(found) for found in _NAMED.findall(line.text))


def matches(brief: str, cut: str) -> bool:
    """Whether `cut` is `brief`, possibly cut in its middle to fit a longer line."""
    if brief == cut:
        return True
    head, dots, tail = cut.partition("..")
    return bool(dots) and brief.startswith(head) and brief.endswith(tail)
