"""What the results about one configured topic have in common."""

from __future__ import annotations

from phm import api
from phm.api import Level
from phm_checks._text import brief, last


def unit_id(topic: api.TopicSettings) -> str:
    return f"topics/{api.topic_id(topic.name)}"


def numbers(seen: api.TopicFact) -> dict[str, api.Value]:
    return {"publishers": len(seen.publishers), "subscribers": len(seen.subscribers)}


def problem(
    topic: api.TopicSettings,
    seen: api.TopicFact,
    level: Level,
    condition: str,
    short: str,
    words: str,
    container: str,
) -> api.Result:
    """short: for the line of 50 characters, after the topic's name. container: the target of the recovery; empty: none."""
    return api.Result(level, words, brief(last(topic.name), short), condition, container, numbers(seen))
