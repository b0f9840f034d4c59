"""Rules for `ready` of containers and nodes."""

from __future__ import annotations

import math
from collections.abc import Iterator

from phm.config.node import ConfigNode
from phm.config.rules.common import in_order, report_duplicates, without_slash
from phm.core.settings import ReadySettings, RecoverySettings, RosSettings, Seconds


def ready_names_something(root: ConfigNode) -> None:
    for ready, keys in _sections(root):
        if isinstance(ready.value, dict) and not any(ready.get(key).value for key in keys):
            ready.add_problem(f"names nothing that must be there: add one of {', '.join(keys)}, or remove 'ready'")
        for key, what in (("topics", "topic"), ("services", "service")):
            report_duplicates(what, ((without_slash(place.text), place) for place in ready.get(key).texts))


def ready_topics_are_not_monitored(root: ConfigNode) -> None:
    """The silence of a topic with a rate is a fault already; a second one would have the same cause."""
    monitored = {without_slash(topic.get("name").text) for topic in root.get("ros", "topics").records()}
    for ready, _ in _sections(root):
        for place in ready.get("topics").texts:
            if without_slash(place.text) in monitored:
                place.add_problem(
                    "is in 'ros.topics', which reports its silence if it has a 'rate': remove it from one of them"
                )


def ready_within_verification(root: ConfigNode) -> None:
    """A restart is verified for `recovery.verify`; what may take longer to be ready could never be verified."""
    defaults = (ReadySettings.model_fields["within"].default, RecoverySettings().verify)
    for ready, _ in _sections(root):
        if isinstance(ready.value, dict):
            in_order(ready.get("within"), root.get("recovery", "verify"), Seconds, defaults)


def ready_keys_have_an_effect(root: ConfigNode) -> None:
    """The grace of a start is `within` or `ros.grace`, whichever is longer; that of a lifecycle node also counts when it is started
    again within its container."""
    grace_s = root.get("ros", "grace").quantity(Seconds, RosSettings.model_fields["grace"].default)
    for ready, _ in _sections(root):
        if ready.get("silence").given and not ready.get("topics").value:
            ready.get("silence").add_problem("is never used without 'topics': add it or remove this")
        within_s = ready.get("within").quantity(Seconds, math.inf)
        if within_s is not None and grace_s is not None and within_s < grace_s and not ready.get("lifecycle").given:
            ready.get("within").add_problem(
                f"is {within_s:g}, below ros.grace which is {grace_s:g} and is waited for: allowed is {grace_s:g} or more"
            )


def _sections(root: ConfigNode) -> Iterator[tuple[ConfigNode, tuple[str, ...]]]:
    """Each `ready` that is given, and its keys of requirements."""
    for container in root.get("containers").records():
        if container.get("ready").given:
            yield container.get("ready"), ("services", "topics", "call")
    for node in root.get("ros", "nodes").records():
        if node.get("ready").given:
            yield node.get("ready"), ("lifecycle", "services", "topics", "call")
