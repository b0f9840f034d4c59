"""What a recording of ROS 2 has to say: changes of diagnostics, errors in /rosout, and the times of each topic.

For rosbag2 and MCAP. Times are those at which the recorder received a message.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from phm.core.extras import remedy
from phm.review.cdr import Status
from phm.review.cdr_read import line, statuses
from phm.review.decompression import ZSTD, zstd
from phm.review.events import Event
from phm.review.external_entry import MOST, MOST_SYSTEMS, plain
from phm.review.lines import Problems
from phm.review.topic_times import TopicTimes

TYPES = {
    "diagnostic_msgs/msg/DiagnosticArray": "diagnostics",
    "diagnostic_msgs/DiagnosticArray": "diagnostics",
    "rcl_interfaces/msg/Log": "log",
    "rcl_interfaces/Log": "log",
}
LEVELS = ("OK", "WARN", "ERROR", "STALE")
ERROR, FATAL = 40, 50
MOST_TOPICS = 1000
MOST_STATUSES = 5000
MOST_MESSAGE = 4_000_000
"""Maximum number of bytes of a message that is decoded."""
MOST_NAME = 120
SAME_S = 10.0
"""The same line of the same node within this time is shown once."""
MOST_LINES = 2000
_OURS = re.compile(r"phm/([^/:]+)[/:]")
CANNOT = "only the times of their messages are read"


@dataclass
class Topic:
    """reads: "diagnostics", "log", or empty: only its times are read."""

    name: str
    kind: str
    reads: str = ""
    times: TopicTimes = field(default_factory=TopicTimes)


class Recording:
    """Takes topics and their messages; has the events after the last one, because whose they are may come late."""

    def __init__(self, path: str, problems: Problems) -> None:
        self.topics: dict[int, Topic] = {}
        self._path, self._problems = path, problems
        self._events: list[tuple[str, Event]] = []
        self._levels: dict[str, int] = {}
        self._lines: dict[tuple[str, str], float] = {}
        self._agents: dict[str, int] = {}

    def topic(self, number: int, name: str, kind: str, encoding: str) -> None:
        """kind: name of its type; empty: unknown. encoding: of its messages."""
        if number in self.topics:
            return
        if len(self.topics) >= MOST_TOPICS:
            self.problem(f"more than {MOST_TOPICS} topics; the others are left out")
            return
        reads = TYPES.get(kind, "")
        if encoding != "cdr":
            self.problem(f"topics in the encoding {encoding[:30]!r}: {CANNOT}")
            reads = ""
        elif not kind:
            self.problem(f"topics without a type: {CANNOT}")
        if name.endswith("_agg"):
            reads = ""  # the aggregator repeats under other names what is in /diagnostics
        self.topics[number] = Topic(name[:MOST_NAME], kind[:MOST_NAME], reads)

    def problem(self, what: str, count: int = 1) -> None:
        self._problems.add(what, self._path, count=count)

    def take(self, number: int, t: float, data: bytes | None) -> None:
        """t: UTC seconds. data: None where the topic is not decoded, or the message is too long."""
        topic = self.topics.get(number)
        if topic is None:
            self.problem("messages of a topic that is not described, left out")
            return
        topic.times.add(t)
        if not topic.reads:
            return
        if data is None:
            self.problem(f"messages of more than {MOST_MESSAGE} bytes: only their times are read")
            return
        try:
            data = zstd(data, MOST_MESSAGE) if data.startswith(ZSTD) else data
            self._diagnostics(t, statuses(data)) if topic.reads == "diagnostics" else self._log(t, data)
        except ImportError as error:
            self.problem(f"packed messages, for which {error.name} is missing: {remedy('report')}")
        except ValueError:
            self.problem(f"damaged messages of {topic.kind}, of which only the time is read")

    def events(self) -> Iterator[Event]:
        """All events of the recording, each with its agent where that is known."""
        end = max((topic.times.last for topic in self.topics.values() if topic.times.count), default=0.0)
        for topic in self.topics.values():
            self._times(topic, end)
        alone = next(iter(self._agents.values())) if len(self._agents) == 1 else 0
        for owner, event in self._events:
            event.system = self._agents.get(owner, alone)
            yield event

    def _diagnostics(self, t: float, array: list[Status]) -> None:
        for status in array:
            name = status.name[:MOST_NAME]
            if status.name.endswith(": summary") and (ours := _OURS.match(status.name)):
                self._agent(ours[1], status)
            before = self._levels.get(name)
            if before is None and len(self._levels) >= MOST_STATUSES:
                self.problem(f"more than {MOST_STATUSES} names in diagnostics; the others are left out")
                continue
            self._levels[name] = status.level
            if status.level == (before or 0):
                continue
            level = LEVELS[status.level] if status.level < len(LEVELS) else "STALE"
            said = status.message if level in ("WARN", "ERROR") else f"{level}: {status.message}"
            owner = _OURS.match(status.name)
            event = Event("diagnostic", utc_s=t, text=f"{name}: {said}", level="" if level == "OK" else level)
            self._add(event, owner[1] if owner else "")

    def _agent(self, name: str, status: Status) -> None:
        """The summary of PHM's own diagnostics has the id of its agent."""
        number = dict(status.values).get("agent_id", "")
        if re.fullmatch(r"[1-9]\d{0,2}", number) and int(number) < MOST_SYSTEMS and len(self._agents) < MOST_SYSTEMS:
            self._agents.setdefault(name, int(number))

    def _log(self, t: float, data: bytes) -> None:
        # Level first: most lines are not errors, and their texts need not be read.
        if len(data) > 12 and data[12] < ERROR:
            return
        said = line(data)
        key = (said.name[:MOST_NAME], said.message[:MOST_NAME])
        if t - self._lines.get(key, float("-inf")) < SAME_S:
            self.problem(f"errors in /rosout that the same node repeated within {SAME_S:g} s, shown once")
            return
        if len(self._lines) >= MOST_LINES:
            self._lines.clear()
        self._lines[key] = t
        fatal = "FATAL: " if said.level >= FATAL else ""
        self._add(Event("rosout", utc_s=t, text=f"{fatal}{key[0]}: {said.message}", level="ERROR"))

    def _times(self, topic: Topic, end: float) -> None:
        times = topic.times
        if not times.count:
            return
        if times.early:
            self.problem("messages that are older than one before them in the file", times.early)
        period, limit = times.period(), times.limit()
        self._add(Event("topic", utc_s=times.first, text=f"{topic.name}: first message ({topic.kind or 'no type'})"))
        usual = "" if period is None else f", median period {period:.3f} s"
        stopped = limit is not None and end - times.last > limit
        text = f"{topic.name}: last of {times.count} messages{usual}"
        if stopped:
            text += f", {end - times.last:.1f} s before the recording ends"
        self._add(Event("topic", utc_s=times.last, text=text, level="WARN" if stopped else ""))
        for begin, long in times.gaps():
            self._add(Event("gap", utc_s=begin, text=f"{topic.name}: no message for {long:.2f} s{usual}", level="WARN"))

    def _add(self, event: Event, owner: str = "") -> None:
        if len(self._events) < MOST:
            event.text = plain(event.text)[:400]
            self._events.append((owner, event))
        else:
            self.problem(f"more than {MOST} events; the others are left out")
