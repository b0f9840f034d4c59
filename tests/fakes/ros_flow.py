"""Publishers and a queue without ROS: what a poll per tick would find of publications at given times."""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from phm.facts.ros import RateFact
from phm.probes.ros.rates.estimator import ALONE, Listening, RateEstimator
from phm.probes.ros.rates.publisher_stats import Sample

TICK_S = 0.25
TRACES = Path(__file__).resolve().parents[1] / "ros" / "traces"
EPOCH_S = 1.7e9
"""What the publishers' clocks show at 0."""


@dataclass(frozen=True, order=True)
class Publication:
    """received_s: by our monotonic clock. published_s: by the publisher's own, as seconds after EPOCH_S."""

    received_s: float
    published_s: float
    sequence: int | None
    writer: bytes | None = None
    size: int = 100


@dataclass(frozen=True)
class Trace:
    """Publications of a real process as they were received, in seconds from the first one."""

    hz: float
    publications: list[Publication]

    @property
    def end_s(self) -> float:
        return self.publications[-1].received_s


def trace(name: str) -> Trace:
    """See `traces/record.py` for the form."""
    data = json.loads((TRACES / f"{name}.json").read_text("utf-8"))
    at_s, number, publications = 0.0, 1, []
    for place, delay in enumerate(data["delays"]):
        publications.append(Publication(at_s + delay / 1e4, at_s, number))
        if place < len(data["gaps"]):
            at_s += data["gaps"][place] / 1e4
            number += 1 + data["lost"].get(str(place), 0)
    return Trace(data["hz"], publications)


def even(
    hz: float,
    start_s: float,
    seconds: float,
    *,
    first: int = 1,
    writer: bytes | None = None,
    offset_s: float = 0.0,
    numbered: bool = True,
    size: int = 100,
    delay_s: float = 0.0,
) -> list[Publication]:
    """One publisher without jitter. offset_s: its clock relative to ours. The first is published a period after `start_s`."""
    return [
        Publication(
            start_s + count / hz + delay_s,
            start_s + count / hz + offset_s,
            first + count - 1 if numbered else None,
            writer,
            size,
        )
        for count in range(1, int(seconds * hz + 1e-9) + 1)
    ]


def polls(
    publications: Iterable[Publication], start_s: float, end_s: float, depth: int = 1, tick_s: float = TICK_S
) -> Iterator[tuple[float, list[Sample]]]:
    """Each poll and the contents of a queue of `depth` at that time."""
    coming = deque(sorted(publications, key=lambda publication: publication.received_s))
    for number in range(1, round((end_s - start_s) / tick_s) + 1):
        now_s = start_s + number * tick_s
        queue: deque[Publication] = deque(maxlen=depth)
        while coming and coming[0].received_s <= now_s + 1e-9:
            queue.append(coming.popleft())
        yield now_s, [_sample(publication, now_s) for publication in queue]


def feed(
    meter: RateEstimator,
    publications: Iterable[Publication],
    start_s: float,
    end_s: float,
    *,
    depth: int = 1,
    listening: Listening = ALONE,
    tick_s: float = TICK_S,
) -> RateFact:
    """The estimator after all polls."""
    facts = [
        meter.update(now_s, samples, replace(listening, complete=len(samples) < depth))
        for now_s, samples in polls(publications, start_s, end_s, depth, tick_s)
    ]
    return facts[-1]


def quiet(meter: RateEstimator, start_s: float, seconds: float, listening: Listening = ALONE) -> RateFact:
    """The estimator after polls without data."""
    return feed(meter, (), start_s, start_s + seconds, listening=listening)


def silent_from(meter: RateEstimator, publications: Sequence[Publication], start_s: float, end_s: float) -> list[float]:
    """The times at which the verdict of silence began."""
    began, before = [], False
    for now_s, samples in polls(publications, start_s, end_s):
        silent = meter.update(now_s, samples).hz == 0.0
        if silent and not before:
            began.append(now_s)
        before = silent
    return began


def _sample(publication: Publication, now_s: float) -> Sample:
    return Sample(
        publication.sequence,
        int((EPOCH_S + publication.published_s) * 1e9),
        now_s,
        publication.writer,
        publication.size,
        publication.received_s - publication.published_s,
        now_s - publication.received_s,
    )
