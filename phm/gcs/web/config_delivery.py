"""Delivers the files of the Checks page to their agents over IP. Addresses and keys are those of the command line, never the browser's."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from phm.gcs import delivery_client
from phm.wire.delivery import DeliveryAnswer, version_of


class NotDelivered(Exception):
    """It was not sent, or the agent did not answer; the message says why."""


@dataclass(frozen=True, slots=True)
class DeliveryTarget:
    """Where an agent listens (`delivery.listen`), and its key."""

    host: str
    port: int
    key: bytes = field(repr=False)

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


class ConfigDelivery:
    """targets: by the name of the file. Thread-safe; one delivery at a time, because each one keeps a thread."""

    def __init__(self, targets: Mapping[str, DeliveryTarget]) -> None:
        self._targets = dict(targets)
        self._lock = threading.Lock()

    def targets(self) -> dict[str, str]:
        """The address at which the agent of each file listens, by the file's name."""
        return {name: str(target) for name, target in self._targets.items()}

    def deliver(self, name: str, text: str, base: str | None) -> dict[str, Any]:
        """The agent's answer: `ok`, `agent`, `text`, `present` (version of its file now) and `problems`.

        base: version of the configuration that is replaced; None: whatever the agent has. Raises NotDelivered, and KeyError for a file
        without an agent.
        """
        target = self._targets[name]
        if not self._lock.acquire(blocking=False):
            raise NotDelivered("another configuration is being delivered: try again when that is done")
        try:
            where = target.host, target.port
            if base is None:
                base = delivery_client.present(where, target.key)
                if base == version_of(text):
                    return _shown("", DeliveryAnswer(True, "the agent has this configuration already", base))
            return _shown(*delivery_client.deliver(where, target.key, text, base))
        except delivery_client.DeliveryFailed as error:
            raise NotDelivered(str(error)) from None
        finally:
            self._lock.release()


def _shown(agent: str, answer: DeliveryAnswer) -> dict[str, Any]:
    return {
        "ok": answer.ok,
        "agent": agent,
        "text": answer.text,
        "present": answer.present,
        "problems": list(answer.problems),
    }
