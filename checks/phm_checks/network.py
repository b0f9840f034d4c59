"""Slot 4: the container is on its networks, PHM is on them too, and the container's address responds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from phm import api
from phm.api import Slot
from phm_checks._data_path import DataPath
from phm_checks._environment_advice import advice
from phm_checks._per_container import PerContainer
from phm_checks._text import brief, clean, joined, listed, merged

_BY_CAUSE = ("network_missing", "no_network", "disconnected", "sidecar_disconnected", "address_silent")
"""Causes before consequences: the first of these found is the condition of the unit."""
_BLOCKED = "Look for a firewall, or for shared memory without a shared /dev/shm (set FASTDDS_BUILTIN_TRANSPORTS=UDPv4)"
_DATA = ("data from its nodes",)
"""`Evidence.subjects` of a path that is cut off."""
GRACE_S = 3.0
"""PHM joins the networks after its own start; until then being disconnected is not a fault."""


class Network(PerContainer):
    """All configured networks of one container."""

    name, slot = "network", Slot.NETWORK
    period_s = 5.0

    def __init__(self, entry: api.ContainerSettings, settings: api.Settings) -> None:
        super().__init__(entry)
        self._data_path = DataPath(self.key, settings)
        self._attached: set[tuple[str, str]] = set()
        """Run of the container, and id of a network on which it was found in that run."""
        self._reached: set[str] = set()
        """Names of networks on which its address has responded to PHM."""
        self._not_checked: set[str] = set()
        """Names of networks on which its address was not checked when they were last looked at."""

    @classmethod
    def build(cls, settings: api.Settings) -> Iterable[api.Check]:
        return [cls(entry, settings) for entry in settings.containers if cls.wanted(entry)]

    @classmethod
    def wanted(cls, entry: api.ContainerSettings) -> bool:
        return bool(entry.networks)

    @property
    def units(self) -> Sequence[api.Unit]:
        return (api.Unit(self.unit_id, needs=(f"container/{self.key}",), target=self.key, grace_s=GRACE_S),)

    @property
    def wakes(self) -> frozenset[str]:
        return super().wakes | {"network"}

    def run(self, world: api.World) -> api.Result:
        fact = world.docker.container(self.key)
        if fact is None or not fact.running:
            self._data_path.interrupted()
            return api.stale(f"networks of {self.key} are not checked while it is not running")
        special = self._mode(fact)
        if special is not None:
            return special
        findings = [self._judge(world, fact, name) for name in self.entry.networks]
        bad = sorted(
            (finding for finding in findings if finding.level.bad),
            # Of silent addresses, one that has responded before is first: only for that one PHM acts.
            key=lambda finding: (_BY_CAUSE.index(finding.condition), finding.evidence.never_ok is None),
        )
        values: dict[str, api.Value] = {"networks": len(findings), "networks_bad": len(bad)}
        if bad:
            return merged(bad, values)
        if (blocked := self._blocked(world, fact)) is not None:
            return blocked
        found = api.ok(joined([finding.summary for finding in findings]), values=values)
        # A blocked path that was reported before PHM was restarted is not over yet; another fault of its networks is.
        return found.with_evidence(api.Evidence(unobserved_of=_DATA if self._data_path.unobserved(world) else ()))

    @property
    def _responds(self) -> bool:
        """Whether an address was checked, in a run in which no network is bad."""
        return self.entry.address and not self._not_checked.issuperset(self.entry.networks)

    def _blocked(self, world: api.World, fact: api.ContainerFact) -> api.Result | None:
        """The result when the networks are correct, but no data from the nodes arrive; None when they do."""
        why, never = self._data_path.why(world, fact.generation), self._data_path.never_received
        if not why and (absent := self._data_path.absent(world)):
            step = advice(world, self.key, "check ROS_DOMAIN_ID, firewalls and discovery between PHM and it")
            return self._bad(
                f"{self.key} is connected{' and responds' if self._responds else ''}, but {absent}: {step}; PHM restarts nothing for this",
                "nodes unreachable",
                "nodes_unreachable",
            ).with_evidence(api.Evidence(subjects=_DATA))
        if not why and self._data_path.waiting(world, fact.generation):
            return api.stale(
                f"{self.key} is connected; its transport was blocked before it was restarted, and nothing has been received from its nodes since"
            )
        if not why and self._data_path.unobserved(world) and self._data_path.cut:
            return api.stale(f"{self.key} is connected; it is not known whether data arrive again from its nodes")
        if not why:
            return None
        cause = (
            f"{advice(world, self.key, _BLOCKED, data_only=True)}: nothing has been received since it was started, so a "
            "restart of the application rarely helps"
            if never
            else "Data was received earlier in this run: look for a firewall rule added since; rules in its own network "
            "namespace are removed by a restart of the application, others are not"
        )
        found = self._bad(
            f"{self.key} is connected{' and responds' if self._responds else ''}; discovery works but no data arrives: {why}. {cause}",
            "transport blocked",
            "transport_blocked",
        )
        # Without an address check the fault may be on PHM's side of the network: no recovery target.
        target = found.target if self._responds else ""
        known = api.Evidence(never_ok=never, subjects=_DATA, patient=self._data_path.by_topics)
        return replace(found, evidence=known, target=target)

    def _mode(self, fact: api.ContainerFact) -> api.Result | None:
        """The result for network modes in which a container has no network itself; None for other modes."""
        mode, names = fact.network_mode, listed(self.entry.networks)
        if mode == "host":
            return api.bypass(
                f"{self.key} uses the host's network itself, so there is no connection to {names} to check."
            )
        if mode.startswith("container:"):
            return api.bypass(f"{self.key} shares the network of {clean(mode, 80)}: check {names} at that container.")
        if mode == "none" and not any(attached.name != "none" for attached in fact.networks):
            return self._bad(
                f"{self.key} runs with network_mode none and cannot be connected to {names}: start it without "
                "network_mode, or remove `networks` from its configuration",
                "has no network",
                "no_network",
            )
        return None

    def _judge(self, world: api.World, fact: api.ContainerFact, name: str) -> api.Result:
        network_id = world.docker.network_id(name)
        if not network_id:
            similar = [one.name for one in fact.networks if one.name.endswith(f"_{name}")]
            hint = f" {self.key} is on {listed(similar)}: is that the intended network?" if similar else ""
            return self._bad(
                f"network {name} does not exist: create it with `docker network create {name}` or `docker compose up -d`.{hint}",
                f"no network {name}",
                "network_missing",
                subject="",
            )
        attached = next((one for one in fact.networks if one.network_id == network_id), None)
        if attached is None:
            gone = any(one.name == name for one in fact.networks)
            why = ": it is still attached to an old network of that name that was removed and recreated" if gone else ""
            detached = self._bad(
                f"{self.key} is not connected to {name}{why}; `docker network connect {name} {fact.name}` connects it",
                f"not on {name}",
                "disconnected",
            )
            # Compose attaches a container before its start; what has been detached since does not come back by itself.
            lost = (fact.generation, network_id) in self._attached
            return detached.with_evidence(api.Evidence(conclusive=True, certain=lost))
        self._attached = {seen for seen in self._attached if seen[0] == fact.generation}
        self._attached.add((fact.generation, network_id))
        return self._sidecar(world, attached, name, network_id)

    def _sidecar(self, world: api.World, attached: api.Attachment, name: str, network_id: str) -> api.Result:
        """PHM and the container can reach each other.

        On the host's network PHM reaches bridge networks. Linux passes nothing between an interface and its macvlan children; other
        drivers may do the same.
        """
        me = world.docker.own_container()
        beside = me is not None and any(one.network_id == network_id for one in me.networks)
        on_host = me is None or me.network_mode == "host"
        if not (beside or on_host):
            shared = me is not None and me.network_mode.startswith("container:")
            connect = "the container whose network PHM shares" if shared else "PHM's container"
            return self._bad(
                f"PHM itself is not on {name}, so it cannot reach {self.key} there: connect {connect} to {name}",
                f"PHM not on {name}",
                "sidecar_disconnected",
                subject="",
            )
        if not self.entry.address:
            return api.ok(f"{self.key} is connected to {name}")
        if not attached.address:
            return self._bad(
                f"{self.key} is connected to {name} but has no address there: disconnect and reconnect it",
                f"no address on {name}",
                "disconnected",
            )
        driver = "" if beside else world.docker.network_driver(name)
        self._not_checked.discard(name)
        if not beside and driver != "bridge":
            self._not_checked.add(name)
            return api.ok(
                f"{self.key} is connected to {name}; its address there is not checked, because PHM is not on this network "
                f"and cannot rely on reaching one of driver {clean(driver, 40) or 'unknown'}"
            )
        # A single lost echo is not a fault, so a silent address is tried twice.
        if world.docker.reachable(attached.address) or world.docker.reachable(attached.address):
            self._reached.add(name)
            return api.ok(f"{self.key} is connected to {name} and responds at {attached.address}")
        silent = self._bad(
            f"{self.key} is connected to {name}, but {attached.address} did not respond to two pings, expected an immediate response: "
            "its interface may be down, or a firewall may drop its traffic",
            f"unreachable on {name}",
            "address_silent",
        )
        # Without this the published state decides: PHM may have been restarted since it responded.
        return silent.with_evidence(api.Evidence(never_ok=False if name in self._reached else None))

    def _bad(self, words: str, short: str, condition: str, subject: str | None = None) -> api.Result:
        named = self.key if subject is None else subject
        return api.error(words, brief=brief(named, short), condition=condition, target=self.key)
