"""What a node has received, in a file: so that others than PHM can observe whether the application works.

Twice a second each node writes `/tmp/received/<node>.json` if that folder exists, as in the image of the demo application: ``at``, the
moment on the monotonic clock, and under ``topics``, for each topic that it subscribes to, what `Reception.summary` has.
"""

from __future__ import annotations

import itertools
import json
import os
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

FOLDER = Path("/tmp/received")
WRITE_S = 0.5
WINDOW_S = 1.2
RATE_WINDOW_S, GAP_S = 3.0, 1.0
"""The rate is that of the messages of the first, since the last pause of more than the second: on a machine that is short of CPU
time one late message changes the rate of a topic of 5 Hz over 1.2 s by more than the 20 % that are wrong."""
LEAST, MOST = 3, 64
"""Messages that a summary is about: those of its window, but not fewer and not more than these, if there were so many."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One message. at: monotonic seconds. count: its counter; None: it has none. stamp_s: stamp, as seconds ahead of the clock."""

    at: float
    content: Any
    count: int | None = None
    stamp_s: float = 0.0


class Reception:
    """The newest messages of one topic."""

    def __init__(self) -> None:
        self._samples: deque[Sample] = deque(maxlen=MOST)

    def add(self, sample: Sample) -> None:
        self._samples.append(sample)

    def summary(self, now: float) -> dict[str, float]:
        """``rate_hz``; ``age_s`` of the newest message, -1 without any; ``same``, messages with the content of the one before;
        ``lost``, numbers that the counter left out; ``stamp_s``, the largest distance of a stamp from the clock."""
        seen = list(self._samples)
        recent = _since(seen, now - WINDOW_S)
        pairs = list(itertools.pairwise(recent))
        return {
            "rate_hz": _rate_hz(_since(seen, max(now - RATE_WINDOW_S, _last_before_pause(seen)))),
            "age_s": round(now - recent[-1].at, 3) if recent else -1.0,
            "same": sum(one.content == two.content for one, two in pairs),
            "lost": sum(_left_out(one, two) for one, two in pairs),
            "stamp_s": round(max((abs(sample.stamp_s) for sample in recent), default=0.0), 3),
        }


class Record:
    """The receptions of one node and their file."""

    def __init__(self, node: str, folder: Path = FOLDER) -> None:
        self._file = folder / f"{node}.json"
        self._topics: dict[str, Reception] = {}
        self._next_s = 0.0

    def listener(self, topic: str) -> Callable[[Any], None]:
        """The callback of a subscription to std_msgs/String."""
        reception = self.of(topic)
        return lambda message: reception.add(Sample(time.monotonic(), message.data))

    def of(self, topic: str) -> Reception:
        return self._topics.setdefault(topic, Reception())

    def forget(self, topic: str) -> None:
        self._topics.pop(topic, None)

    def due(self) -> bool:
        """Write the file if it is time for it; whether it was."""
        now = time.monotonic()
        if now < self._next_s:
            return False
        self._next_s = now + WRITE_S
        _write(self._file, {"at": now, "topics": {topic: each.summary(now) for topic, each in self._topics.items()}})
        return True


def _since(seen: list[Sample], at: float) -> list[Sample]:
    recent = [sample for sample in seen if sample.at > at]
    return recent if len(recent) >= LEAST else seen[-LEAST:]


def _last_before_pause(seen: list[Sample]) -> float:
    """When the last message before the last pause came; without a pause long ago."""
    newest_first = itertools.pairwise(reversed(seen))
    return next((before.at for after, before in newest_first if after.at - before.at > GAP_S), float("-inf"))


def _rate_hz(recent: list[Sample]) -> float:
    took_s = recent[-1].at - recent[0].at if len(recent) > 1 else 0.0
    return round((len(recent) - 1) / took_s, 3) if took_s > 0 else 0.0


def _left_out(one: Sample, two: Sample) -> int:
    """Numbers between the counters of two messages. A counter that starts again left out none."""
    return max(0, two.count - one.count - 1) if one.count is not None and two.count is not None else 0


def _write(file: Path, found: Mapping[str, Any]) -> None:
    """Replace the file as a whole. A missing folder or a full disk does not end the node."""
    new = file.with_suffix(".new")
    try:
        new.write_text(json.dumps(found), "ascii")
        os.replace(new, file)
    except OSError:
        return
