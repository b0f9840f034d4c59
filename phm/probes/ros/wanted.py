"""What the child process of the ROS probe observes: the order of the configuration, as its first line."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from phm.core.settings import DataSettings, ReadySettings, RosSettings
from phm.probes.ros.protocol import Wanted, WantedData, WantedRange, WantedTopic


def wanted(ros: RosSettings, agent: str, ready: Sequence[ReadySettings] = ()) -> Wanted:
    """The configuration of the child: full names of topics, and which of their rates it measures. ready: of the containers."""
    topics = [
        WantedTopic(
            f"/{topic.name.lstrip('/')}",
            topic.rate,
            ros.silence if topic.silence is None else topic.silence,
            None if topic.data is None else _wanted_data(topic.data),
        )
        for topic in ros.topics
    ]
    readiness = [*ready, *(node.ready for node in ros.nodes if node.ready is not None)]
    # Rate 0: received as any latched topic; there is no rate to compare with.
    topics += [WantedTopic(name, 0.0) for name in _full(name for one in readiness for name in one.topics)]
    names = [node.name for node in ros.nodes]
    names += [node for topic in ros.topics for node in (*topic.publishers, *topic.subscribers)]
    return Wanted(
        agent=agent,
        domain=ros.domain,
        topics=tuple(topics),
        listen=tuple(f"/{name.lstrip('/')}" for name in ros.diagnostics.listen),
        nodes=_full(names),
        watch=tuple(entry.name for entry in ros.diagnostics.watch),
        services=_full(name for one in readiness for name in one.services),
        lifecycle=_full(node.name for node in ros.nodes if node.ready is not None and node.ready.lifecycle),
        calls=_full(one.call for one in readiness if one.call is not None),
    )


def _wanted_data(data: DataSettings) -> WantedData:
    return WantedData(
        max_age_s=data.max_age,
        order=data.order,
        frozen_s=data.frozen,
        counter=data.counter or "",
        gaps_percent=data.gaps,
        ranges=tuple(WantedRange(name, low, high) for name, (low, high) in data.ranges.items()),
        hz=data.sample,
    )


def _full(names: Iterable[str]) -> tuple[str, ...]:
    """Each name once, with its first slash."""
    return tuple(dict.fromkeys(f"/{name.lstrip('/')}" for name in names))
