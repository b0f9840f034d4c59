"""Fakes of the ROS graph, of MAVLink and of the swarm."""

from __future__ import annotations

import dataclasses
from typing import Any

from phm.facts import AutopilotFact, GcsFact, LinkFact, MessageValue, RadioFact, RosFact, SwarmFact
from phm.testing.fake import Fake


class FakeRos(Fake):
    """A picture of the graph, fresh and taken by a child that has looked for a minute."""

    def __init__(self, **fields: Any) -> None:
        super().__init__()
        self.fact = dataclasses.replace(RosFact(age_s=0.1, up_s=60.0), **fields)

    def change(self, **fields: Any) -> None:
        self.fact = dataclasses.replace(self.fact, **fields)

    def snapshot(self) -> RosFact:
        self._asked()
        return self.fact


class FakeLinks(Fake):
    """What was received on the MAVLink endpoints. `busy` holds the programs that have a serial port open, by its path."""

    def __init__(
        self,
        gcs_age_s: float | None = 1.0,
        autopilot: AutopilotFact | None = None,
        links: tuple[LinkFact, ...] = (),
        radios: tuple[RadioFact, ...] = (),
    ) -> None:
        super().__init__()
        self.gcs_age = gcs_age_s
        self.gcs_link = ""
        self.gcs_due_s: float | None = None
        self.gcs_overdue = False
        self.pilot = autopilot
        self.endpoints = links
        self.radio_facts = radios
        self.busy: dict[str, tuple[str, ...]] = {}

    def gcs_age_s(self) -> float | None:
        self._asked()
        return self.gcs_age

    def gcs(self) -> GcsFact | None:
        self._asked()
        if self.gcs_age is None:
            return None
        return GcsFact(self.gcs_age, 255, 190, self.gcs_link, self.gcs_due_s, self.gcs_overdue)

    def autopilot(self) -> AutopilotFact | None:
        self._asked()
        return self.pilot

    def radios(self) -> tuple[RadioFact, ...]:
        self._asked()
        return self.radio_facts

    def links(self) -> tuple[LinkFact, ...]:
        self._asked()
        return self.endpoints

    def users(self, path: str) -> tuple[str, ...]:
        self._asked()
        return self.busy.get(path, ())


class FakeMessages(Fake):
    """Values of fields of MAVLink messages, by message and field."""

    def __init__(self) -> None:
        super().__init__()
        self.fields: dict[tuple[str, str], tuple[MessageValue, ...]] = {}

    def values(self, message: str, field: str, *, component: int, instance: int | None) -> tuple[MessageValue, ...]:
        self._asked()
        found = self.fields.get((message, field), ())
        return tuple(value for value in found if instance in (None, value.instance))


class FakeSwarm(Fake):
    """The swarm of an agent that is alone."""

    def __init__(self, **fields: Any) -> None:
        super().__init__()
        self.fact = dataclasses.replace(SwarmFact(own=1, members=1, living=1, up_s=600.0), **fields)

    def change(self, **fields: Any) -> None:
        self.fact = dataclasses.replace(self.fact, **fields)

    def snapshot(self) -> SwarmFact:
        self._asked()
        return self.fact
