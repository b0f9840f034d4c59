"""What the ROS child is to monitor, from the configuration."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from phm.core.settings import (
    CustomCheckSettings,
    DataSettings,
    LifecycleCheckSettings,
    ReadySettings,
    RosSettings,
    ServiceCheckSettings,
    TopicCheckSettings,
)
from phm.probes.ros.protocol import Wanted, WantedCall, WantedData, WantedRange, WantedTopic


def uses_ros(custom: Iterable[CustomCheckSettings]) -> bool:
    """Whether one of these own checks needs the ROS child."""
    return any(isinstance(one, TopicCheckSettings | ServiceCheckSettings | LifecycleCheckSettings) for one in custom)


def wanted(
    ros: RosSettings,
    agent: str,
    ready: Sequence[ReadySettings] = (),
    custom: Sequence[CustomCheckSettings] = (),
) -> Wanted:
    """The configuration of the child: full names of topics, and which of their rates it measures. ready: of the containers.
    custom: the own checks."""
    readiness = [*ready, *(node.ready for node in ros.nodes if node.ready is not None)]
    services = [one for one in custom if isinstance(one, ServiceCheckSettings)]
    names = [node.name for node in ros.nodes]
    names += [node for topic in ros.topics for node in (*topic.publishers, *topic.subscribers)]
    states = [node.name for node in ros.nodes if node.ready is not None and node.ready.lifecycle]
    states += [one.node for one in custom if isinstance(one, LifecycleCheckSettings)]
    return Wanted(
        agent=agent,
        domain=ros.domain,
        topics=_topics(ros, readiness, [one for one in custom if isinstance(one, TopicCheckSettings)]),
        listen=tuple(f"/{name.lstrip('/')}" for name in ros.diagnostics.listen),
        nodes=_full(names),
        watch=tuple(entry.name for entry in ros.diagnostics.watch),
        services=_full([*(name for one in readiness for name in one.services), *(one.service for one in services)]),
        lifecycle=_full(states),
        calls=_calls(readiness, services),
    )


def _topics(
    ros: RosSettings, readiness: Sequence[ReadySettings], custom: Sequence[TopicCheckSettings]
) -> tuple[WantedTopic, ...]:
    topics = {
        name: WantedTopic(
            name,
            topic.rate,
            ros.silence if topic.silence is None else topic.silence,
            None if topic.data is None else _wanted_data(topic.data),
            topic.silence or 0.0,
        )
        for topic in ros.topics
        for name in _full([topic.name])
    }
    for name in _full([*(name for one in readiness for name in one.topics), *(one.topic for one in custom)]):
        known = topics.setdefault(name, WantedTopic(name, 0.0))
        if known.rate_hz is None:
            # Rate 0: received as any latched topic; there is no rate to compare with.
            topics[name] = replace(known, rate_hz=0.0)
    for one in custom:
        if one.field is not None:
            (name,) = _full([one.topic])
            data = topics[name].data or WantedData()
            fields = tuple(dict.fromkeys((*data.fields, one.field)))
            topics[name] = replace(topics[name], data=replace(data, fields=fields))
    return tuple(topics.values())


def _calls(readiness: Sequence[ReadySettings], services: Sequence[ServiceCheckSettings]) -> tuple[WantedCall, ...]:
    """Each service once; a call of `ready` is made often enough for both."""
    calls = {name: WantedCall(name) for name in _full(one.call for one in readiness if one.call is not None)}
    for one in services:
        (name,) = _full([one.service])
        if one.call is not None:
            # A call that waits is not repeated: it may have an effect.
            calls.setdefault(name, WantedCall(name, one.call, one.period, max(one.period, 2 * one.timeout)))
    return tuple(calls.values())


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
