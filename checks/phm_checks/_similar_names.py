"""Topics whose names are almost those in the configuration, which reveal a misspelled or wrongly remapped name.

Not a check: pure rules, used by `topics`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from phm import api
from phm_checks._text import clean, last, listed, one_edit_apart

_DIGITS = re.compile(r"\d+")


@dataclass(frozen=True)
class SimilarName:
    """A topic that is not configured. why: how its name differs from the configured one. sure: the difference is hardly intended."""

    name: str
    why: str
    sure: bool
    uses: api.NameFact

    @property
    def unfed(self) -> bool:
        """Whether it has a subscriber but no publisher."""
        return bool(self.uses.subscribers) and not self.uses.publishers

    @property
    def one_sided(self) -> bool:
        return not (self.uses.publishers and self.uses.subscribers)

    def used_by(self, nodes: Iterable[str]) -> bool:
        return not {*self.uses.publishers, *self.uses.subscribers}.isdisjoint(nodes)


def similar_names(wanted: str, others: Mapping[str, api.NameFact]) -> list[SimilarName]:
    """Names similar to `wanted`, the most similar first."""
    found = []
    for name, uses in others.items():
        why = difference(wanted, name)
        if why:
            found.append(SimilarName(name, why, _sure(wanted, name), uses))
    return sorted(found, key=lambda stray: (not stray.sure, _WHYS.index(stray.why), stray.name))


_CASE, _EDIT, _SHORT, _LONG, _ELSEWHERE = (
    "different capitalization",
    "one character different",
    "namespace incomplete",
    "extra namespace",
    "in another namespace",
)
_WHYS = (_CASE, _EDIT, _SHORT, _LONG, _ELSEWHERE)


def difference(wanted: str, name: str) -> str:
    """How `name` differs from `wanted`, as text; empty if it is not similar, or equal."""
    if name == wanted:
        return ""
    if name.lower() == wanted.lower():
        return _CASE
    if one_edit_apart(wanted, name):
        return _EDIT
    if last(name) != last(wanted):
        return ""
    if wanted.endswith(name):
        return _SHORT
    return _LONG if name.endswith(wanted) else _ELSEWHERE


def _sure(wanted: str, name: str) -> bool:
    """Whether the name is a likely mistake: names that differ only in a number or the namespace usually belong to related topics."""
    if difference(wanted, name) == _ELSEWHERE:
        return False
    return _DIGITS.sub("", wanted) != _DIGITS.sub("", name)


def sentence(wanted: str, stray: SimilarName) -> str:
    """`/agent_1/node_2 subscribes to /agent_1/topc_1, one character different: did you mean /agent_1/topic_1?`."""
    publishers, subscribers = stray.uses.publishers, stray.uses.subscribers
    users = [
        f"{listed(nodes, 3)} {verb}"
        for nodes, verb in (
            (publishers, "publishes" if len(publishers) == 1 else "publish"),
            (subscribers, "subscribes to" if len(subscribers) == 1 else "subscribe to"),
        )
        if nodes
    ]
    return f"{' and '.join(users)} {clean(stray.name, 100)}, {stray.why}: did you mean {wanted}?"
