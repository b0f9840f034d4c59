"""The network between agents: each has one radio there, and receives all others of its group. No sockets, no clock."""

from __future__ import annotations

import random
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

from sitl.simulation.channel_model import Conditions, Losses, Pipe

DELAY_S = 0.01


class _Radio:
    def __init__(self, chance: random.Random) -> None:
        self.air = Conditions(delay_s=DELAY_S)
        self.pipe: Pipe[bytes] = Pipe(self.air, chance, filled=True)
        self.receives = Losses(chance)
        self.counts: Counter[str] = Counter()


class Mesh:
    """`take` an agent's datagram, advance the time with `tick`, which returns (receiving agent, bytes)."""

    def __init__(self, agents: Iterable[int], chance: random.Random) -> None:
        self._radios = {agent: _Radio(chance) for agent in agents}
        self.groups: list[list[int]] = []

    def take(self, now: float, agent: int, data: bytes) -> None:
        radio = self._radios[agent]
        # Unlike a pair to the ground, there is no certain receiver: frames sent while cut are lost.
        if not (radio.air.off or radio.air.cut) and radio.pipe.offer(now, len(data), data):
            radio.counts["to_peers"] += len(data)

    def tick(self, now: float) -> list[tuple[int, bytes]]:
        """The frames that arrive by `now`, with their receivers. Losses are drawn twice: at the sender and at the
        receiver.
        """
        found = []
        for sender, radio in self._radios.items():
            for data in radio.pipe.arrived(now):
                found += [
                    (agent, data) for agent in self._radios if agent != sender and self._receives(agent, sender, data)
                ]
        return found

    def next_s(self) -> float | None:
        moments = (radio.pipe.next_s() for radio in self._radios.values())
        return min((moment for moment in moments if moment is not None), default=None)

    def change(self, agent: int, values: dict[str, Any]) -> None:
        """Like `LinkEmulatorClient.set` for `peers`."""
        radio = self._radios[agent]
        radio.air.change(values)
        if radio.air.off:
            radio.pipe.clear()

    def reset(self, agent: int) -> None:
        self._radios[agent].air.change(asdict(Conditions(delay_s=DELAY_S)))

    def split(self, groups: Sequence[Sequence[int]]) -> None:
        """Split the network. Raises ValueError for an unknown agent, or one named twice."""
        named = [agent for group in groups for agent in group]
        wrong = sorted(set(named) - set(self._radios))
        if wrong or len(set(named)) != len(named):
            raise ValueError(f"groups {list(groups)}: name agents of {sorted(self._radios)}, each once at most")
        self.groups = [list(group) for group in groups]

    def state(self, agent: int) -> dict[str, Any]:
        return asdict(self._radios[agent].air)

    def counts(self, agent: int) -> dict[str, int]:
        radio = self._radios[agent]
        return {**radio.counts, "peers_lost": radio.pipe.lost + radio.pipe.full + radio.counts["missed"]}

    def _receives(self, agent: int, sender: int, data: bytes) -> bool:
        radio = self._radios[agent]
        if radio.air.cut or radio.air.off or not self._together(agent, sender):
            return False
        if radio.receives.next(radio.air.loss, radio.air.burst):
            radio.counts["missed"] += 1
            return False
        radio.counts["from_peers"] += len(data)
        return True

    def _together(self, one: int, other: int) -> bool:
        return not self.groups or any(one in group and other in group for group in self.groups)
