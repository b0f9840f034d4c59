"""The expected state of a container after the received events, and differences from the observed state. Pure functions."""

from __future__ import annotations

from dataclasses import dataclass, replace

from phm.facts import ContainerFact


@dataclass(frozen=True, slots=True)
class ExpectedState:
    """A container as last observed, updated by the events since. None: an event made it unknown, so it cannot differ.

    id: empty if there is no container. networks: pairs of name and network id.
    """

    id: str | None = ""
    status: str | None = ""
    started_at: str | None = ""
    health: str | None = ""
    exit_code: int | None = 0
    networks: frozenset[tuple[str, str]] | None = frozenset()

    @classmethod
    def of(cls, fact: ContainerFact | None) -> ExpectedState:
        if fact is None:
            return cls()
        networks = frozenset((attached.name, attached.network_id) for attached in fact.networks)
        return cls(fact.id, fact.status, fact.started_at, fact.health, fact.exit_code, networks)


_UNKNOWN = ExpectedState(None, None, None, None, None, None)


def after(expected: ExpectedState, action: str, detail: str, subject: str) -> ExpectedState:
    """The expected state after an event.

    detail:  the health for ``health_status``, the network's name for ``connect`` and ``disconnect``.
    subject: id of the container, or of the network.
    """
    if action in ("connect", "disconnect"):
        if expected.networks is None:
            return expected
        others = frozenset(pair for pair in expected.networks if pair[0] != detail)
        return replace(expected, networks=others | {(detail, subject)} if action == "connect" else others)
    if action == "start":
        # A container that ends immediately has a `die` event; its networks get new ids only by `connect`.
        return ExpectedState(subject, "running", None, None, None, expected.networks)
    if action == "die":
        # Its restart policy may already be restarting it.
        return replace(_UNKNOWN, id=subject)
    if action == "pause":
        return replace(expected, status="paused")
    if action == "unpause":
        return replace(expected, status="running")
    if action == "health_status":
        return replace(expected, health=detail)
    if action in ("create", "destroy", "rename"):
        return _UNKNOWN
    return expected


def differences(expected: ExpectedState, now: ExpectedState) -> list[tuple[str, str, str]]:
    """Events that explain the change from `expected` to `now`: (kind, action, detail or network name)."""
    if expected.id is not None and expected.id != now.id:
        # Another container, or none: the rest cannot be compared.
        return [("container", "create" if now.id else "destroy", "")]
    found: list[tuple[str, str, str]] = []
    status = _status_change(expected, now)
    if status is not None:
        found.append(("container", *status))
    if expected.health not in (None, now.health) and now.health in ("healthy", "unhealthy"):
        found.append(("container", "health_status", now.health))
    if expected.networks is not None and now.networks is not None:
        found += [("network", "disconnect", name) for name, _ in sorted(expected.networks - now.networks)]
        found += [("network", "connect", name) for name, _ in sorted(now.networks - expected.networks)]
    return found


def _status_change(expected: ExpectedState, now: ExpectedState) -> tuple[str, str] | None:
    if expected.status in (None, now.status):
        again = expected.started_at not in (None, now.started_at)
        return ("restart", "") if again and now.status == "running" else None
    if now.status == "running":
        return ("unpause" if expected.status == "paused" else "start"), ""
    if now.status == "paused":
        return "pause", ""
    return "die", f"exit code {now.exit_code}"
