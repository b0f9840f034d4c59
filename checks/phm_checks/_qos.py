"""Whether DDS connects a publisher with a subscription, by the request-vs-offered rules of quality of service.

The rules are those of `rmw_qos_profile_check_compatible`: a publisher must offer at least what a subscription requests, in
reliability, durability and liveliness, and with periods (deadline, liveliness lease) that are not longer. Policies that are not
reported (an older middleware, `system_default`) are not evaluated. Not a check: pure rules, used by `topics`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from phm import api

# From the weakest to the strongest, with rclpy's names.
_KINDS = {
    "reliability": ("best_effort", "reliable"),
    "durability": ("volatile", "transient_local"),
    "liveliness": ("automatic", "manual_by_node", "manual_by_topic"),
}
_PERIODS = {"deadline": "deadline_s", "liveliness lease": "lease_s"}


@dataclass(frozen=True)
class Mismatch:
    """One policy that prevents a pair from connecting. offered, asked: as text. raise_offer, lower_ask: settings that would fix it."""

    policy: str
    offered: str
    asked: str
    raise_offer: str
    lower_ask: str


def mismatches(out: api.EndpointFact, into: api.EndpointFact) -> list[Mismatch]:
    """Why publisher `out` does not serve subscription `into`; empty if it does, or if no mismatch is known."""
    return [*_kinds(out, into), *_periods(out, into)]


def _kinds(out: api.EndpointFact, into: api.EndpointFact) -> Iterator[Mismatch]:
    for policy, kinds in _KINDS.items():
        offered, asked = _plain(getattr(out, policy)), _plain(getattr(into, policy))
        if offered in kinds and asked in kinds and kinds.index(offered) < kinds.index(asked):
            yield Mismatch(policy, offered, asked, asked, offered)


def _periods(out: api.EndpointFact, into: api.EndpointFact) -> Iterator[Mismatch]:
    for policy, field in _PERIODS.items():
        offered_s, asked_s = getattr(out, field), getattr(into, field)
        if asked_s is None or (offered_s is not None and offered_s <= asked_s):
            continue
        offered = "none" if offered_s is None else f"{offered_s:g} s"
        lower = "none" if offered_s is None else f"{offered_s:g} s or more"
        yield Mismatch(policy, offered, f"{asked_s:g} s", f"{asked_s:g} s or less", lower)


def _plain(policy: str) -> str:
    return policy.lower().replace("-", "_").replace(" ", "_")
