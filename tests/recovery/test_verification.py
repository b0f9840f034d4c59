"""How long the verification of an action waits before the action counts as failed. Pure."""

from __future__ import annotations

import pytest

from phm.api import Result, error, stale
from phm.core.model import Evidence
from phm.recovery.actions.join_network import JoinNetwork
from phm.recovery.actions.reconnect import Reconnect
from phm.recovery.actions.unpause import Unpause
from phm.recovery.base import Action
from phm.recovery.verification import STARVED_S, STILL_BAD_S, Verification, VerificationResult

GRACE_S = 3.0


class Silent:
    """A unit that every run finds bad; the newest run began at `started`."""

    def __init__(self, started: float) -> None:
        self.started = started

    def found_ok(self, unit: str, mono: float) -> bool:
        return False

    def failing_dependents(self, unit: str, mono: float) -> tuple[str, ...]:
        return ()

    def unknown_dependents(self, unit: str, mono: float) -> tuple[str, ...]:
        return ()

    def dependencies(self, unit: str) -> tuple[str, ...]:
        return ()

    def newest(self, unit: str, mono: float) -> Result | None:
        found = error("silent", brief="silent", condition="address_silent")
        return found if self.started >= mono else None

    def active_pressure(self, unit: str) -> str:
        return ""


class Alone(Silent):
    """The unit is OK, and its dependents stay away."""

    def found_ok(self, unit: str, mono: float) -> bool:
        return True

    def failing_dependents(self, unit: str, mono: float) -> tuple[str, ...]:
        return ("nodes/one",)


def verdict(started: float, still_bad_after_s: float | None) -> VerificationResult | None:
    """The verdict, with the end of the action at time 0."""
    return Verification("network/app", 0.0, 2.0, 30.0, lambda unit: GRACE_S, still_bad_after_s).result(
        Silent(started), started + 2.0
    )


def test_an_action_with_an_immediate_effect_gets_no_grace() -> None:
    """A reconnected address that is silent after a second has failed, whatever grace the unit has."""
    assert verdict(0.5, still_bad_after_s=1.0) is None
    assert verdict(1.0, still_bad_after_s=1.0) == VerificationResult(missing="network/app")


def test_other_actions_get_the_grace_of_the_unit() -> None:
    """A started container needs time."""
    assert verdict(4.5, still_bad_after_s=None) is None
    assert verdict(5.0, still_bad_after_s=None) == VerificationResult(missing="network/app")


@pytest.mark.parametrize(("dependents_within_s", "longest_s"), [(6.0, 6.0), (None, GRACE_S + 4.0)])
def test_dependents_are_waited_for_as_long_as_the_action_states(
    dependents_within_s: float | None, longest_s: float
) -> None:
    """After a reconnection nothing has to start: the nodes reconnect soon, or not before they are restarted."""
    proving = Verification("network/app", 0.0, 2.0, 30.0, lambda unit: GRACE_S, dependents_within_s=dependents_within_s)
    assert proving.result(Alone(0.0), longest_s) is None
    assert proving.result(Alone(0.0), longest_s + 0.1) == VerificationResult(missing="nodes/one", partly=True)


def of(action: type[Action]) -> Verification:
    """The verification of an action on a container whose unit is OK again and whose nodes are not."""
    made = action()
    return Verification(
        "network/app",
        0.0,
        made.verify_after_s,
        30.0,
        lambda unit: GRACE_S + 20.0,
        made.still_bad_after_s,
        made.dependents_within_s,
        made.proven_by_unit,
    )


def test_phm_on_the_network_again_does_not_wait_for_the_nodes_to_be_discovered() -> None:
    """The application was on its network all the time: only PHM's own unit shows whether PHM has joined."""
    assert of(JoinNetwork).result(Alone(0.0), 0.1) == VerificationResult()
    assert of(JoinNetwork).result(Silent(0.5), 0.6) is None


@pytest.mark.parametrize(("action", "longest_s"), [(Reconnect, 6.0), (Unpause, 12.0)])
def test_nodes_that_go_on_running_are_back_soon_or_not_at_all(action: type[Action], longest_s: float) -> None:
    """Nothing has to start, so the next step does not wait for the grace of a start."""
    assert of(action).result(Alone(0.0), longest_s) is None
    assert of(action).result(Alone(0.0), longest_s + 0.1) == VerificationResult(missing="nodes/one", partly=True)


class Lost(Alone):
    """Of the dependents, the second cannot come back by waiting; its newest run began at `started`, by what was seen at `observed`."""

    def __init__(self, started: float, observed: float = float("inf")) -> None:
        super().__init__(started)
        self.observed = observed

    def failing_dependents(self, unit: str, mono: float) -> tuple[str, ...]:
        return ("nodes/one", "nodes/two")

    def newest(self, unit: str, mono: float) -> Result | None:
        found = error("process ended", brief="dead", condition="node_missing")
        certain = unit == "nodes/two"
        evidence = Evidence(certain=certain, observed=self.observed)
        return found.with_evidence(evidence) if self.started >= mono else None


def test_a_dependent_that_does_not_come_back_by_waiting_is_not_waited_for() -> None:
    """A node whose process had ended before its container was unpaused: the next step is due now, not after the grace of a start."""
    proving = Verification("container/app", 0.0, 1.0, 30.0, lambda unit: GRACE_S)
    assert proving.result(Lost(STILL_BAD_S + 0.9), STILL_BAD_S + 1.0) is None
    assert proving.result(Lost(STILL_BAD_S + 1.0), STILL_BAD_S + 1.1) == VerificationResult(
        missing="nodes/two", partly=True
    )


def test_processes_that_were_listed_before_the_action_do_not_end_the_wait() -> None:
    """They are those of the container's earlier run: the node of this one may be starting."""
    proving = Verification("container/app", 5.0, 1.0, 30.0, lambda unit: GRACE_S)
    started, now = proving.done + STILL_BAD_S + 1.0, proving.done + STILL_BAD_S + 1.1
    assert proving.result(Lost(started, observed=4.0), now) is None
    assert proving.result(Lost(started, observed=5.5), now) == VerificationResult(missing="nodes/two", partly=True)


class Unseen(Silent):
    """The unit is OK; whether its dependents are is not known before `known_at`, and then they are in ERROR or, if `back`, OK."""

    def __init__(self, known_at: float, *, back: bool) -> None:
        super().__init__(0.0)
        self.known_at, self.back, self.now = known_at, back, 0.0

    def found_ok(self, unit: str, mono: float) -> bool:
        return True

    def failing_dependents(self, unit: str, mono: float) -> tuple[str, ...]:
        return ("nodes/one",) if self.now >= self.known_at and not self.back else ()

    def unknown_dependents(self, unit: str, mono: float) -> tuple[str, ...]:
        return ("nodes/one",) if self.now < self.known_at else ()

    def result_at(self, verification: Verification, now: float) -> VerificationResult | None:
        self.now = now
        return verification.result(self, now)


@pytest.mark.parametrize(
    ("back", "expected"), [(True, VerificationResult()), (False, VerificationResult(missing="nodes/one", partly=True))]
)
def test_dependents_that_are_unknown_are_not_back(back: bool, expected: VerificationResult) -> None:
    """PHM's ROS child has just been restarted: its ignorance does not verify that a reconnection has brought back the nodes."""
    verification = Verification("network/app", 0.0, 2.0, 30.0, lambda unit: GRACE_S, dependents_within_s=6.0)
    unseen = Unseen(13.0, back=back)
    assert unseen.result_at(verification, 2.1) is None
    assert unseen.result_at(verification, 12.9) is None
    assert verification.waiting == ("nodes/one",)
    assert unseen.result_at(verification, 13.0) == expected


def test_a_dependent_that_stays_unknown_restarts_nothing() -> None:
    """After `recovery.verify` the unit itself decides."""
    verification = Verification("network/app", 0.0, 2.0, 30.0, lambda unit: GRACE_S, dependents_within_s=6.0)
    unseen = Unseen(100.0, back=False)
    assert unseen.result_at(verification, 30.0) is None
    assert unseen.result_at(verification, 30.1) == VerificationResult()


class Starved(Silent):
    """Like Silent and Alone, of a container that is starved until `until`."""

    def __init__(
        self, started: float, *, unit_ok: bool, until: float = 100.0, condition: str = "node_unreachable"
    ) -> None:
        super().__init__(started)
        self.unit_ok, self.until, self.now, self.condition = unit_ok, until, 0.0, condition

    def newest(self, unit: str, mono: float) -> Result | None:
        return error("bad", brief="bad", condition=self.condition) if self.started >= mono else None

    def found_ok(self, unit: str, mono: float) -> bool:
        return self.unit_ok

    def failing_dependents(self, unit: str, mono: float) -> tuple[str, ...]:
        return ("nodes/one",)

    def active_pressure(self, unit: str) -> str:
        return "pressure/app" if self.now < self.until else ""

    def say(self, proving: Verification, now: float) -> VerificationResult | None:
        self.now = now
        return proving.result(self, now)


@pytest.mark.parametrize("until", [1.0, 100.0])
@pytest.mark.parametrize("unit_ok", [True, False])
def test_a_starved_container_gets_more_time_and_the_attempt_is_not_counted(unit_ok: bool, until: float) -> None:
    """`recovery.verify` once more, also when the starvation has ended meanwhile, and for dependents STARVED_S while it
    lasts; then the attempt has failed, but is not counted.
    """
    starved = Starved(1000.0 if unit_ok else 36.0, unit_ok=unit_ok, until=until)
    proving = Verification("container/app", 0.0, 2.0, 30.0, lambda unit: GRACE_S)
    ends = GRACE_S + 4.0 + (STARVED_S if until > 1.0 else 30.0) if unit_ok else GRACE_S + 2.0 + 30.0
    for now in (0.5, 10.0, 34.0):
        starved.started = now
        assert starved.say(proving, now) is None
    starved.started = ends
    late = starved.say(proving, ends + 0.1)
    assert late is not None and late.not_counted and late.partly is unit_ok


def test_a_failure_that_starvation_does_not_explain_is_counted() -> None:
    """The network of a started container is detached: neither more time nor another start changes that."""
    starved = Starved(100.0, unit_ok=True, condition="disconnected")
    verification = Verification("container/app", 0.0, 2.0, 30.0, lambda unit: GRACE_S)
    ends = GRACE_S + 4.0
    assert starved.say(verification, ends) is None
    assert starved.say(verification, ends + 0.1) == VerificationResult(missing="nodes/one", partly=True)


@pytest.mark.parametrize("until", [1.0, 100.0])
def test_a_unit_that_is_bad_for_another_reason_than_starvation_is_counted(until: float) -> None:
    """In an overload, a container that exits right after its start would be started again every 32 s, for good."""
    starved = Starved(4.9, unit_ok=False, until=until, condition="exited")
    verification = Verification("container/app", 0.0, 2.0, 30.0, lambda unit: GRACE_S)
    assert starved.say(verification, 0.5) is None
    assert starved.say(verification, 5.0) is None
    starved.started = GRACE_S + STILL_BAD_S
    assert starved.say(verification, 5.1) == VerificationResult(missing="container/app")


class Exited(Silent):
    """The unit is unknown; the container that it needs has exited, by a run that began at `started`."""

    def dependencies(self, unit: str) -> tuple[str, ...]:
        return ("container/app",) if unit == "health/app" else ()

    def newest(self, unit: str, mono: float) -> Result | None:
        found = error("exited", brief="exited", condition="exited") if unit == "container/app" else stale("not running")
        return found if self.started >= mono else None


def test_a_dependency_that_fails_after_the_action_ends_the_wait() -> None:
    """Until then no one reports or recovers it; its check runs again meanwhile, for a run that began late enough."""
    verification = Verification("health/app", 0.0, 2.0, 30.0, lambda unit: 20.0 if unit == "health/app" else 0.0)
    assert verification.result(Exited(STILL_BAD_S - 0.1), 2.0) is None
    assert verification.waiting == ("container/app", "health/app")
    assert verification.result(Exited(STILL_BAD_S), 2.1) == VerificationResult(missing="container/app")


class Off(Silent):
    """The unit is unknown, because PHM is not on its network."""

    def dependencies(self, unit: str) -> tuple[str, ...]:
        return ("network/app",) if unit == "nodes/one" else ()

    def newest(self, unit: str, mono: float) -> Result | None:
        off = error("PHM is not on it", brief="PHM not on net", condition="sidecar_disconnected")
        return (off if unit == "network/app" else stale("not seen")) if self.started >= mono else None


@pytest.mark.parametrize(("unit", "not_counted"), [("nodes/one", True), ("network/app", False)])
def test_phm_off_the_network_counts_only_against_joining_it(unit: str, not_counted: bool) -> None:
    """No action on the application takes PHM off; a PHM that cannot join gives up."""
    verification = Verification(unit, 0.0, 2.0, 30.0, lambda unit: GRACE_S)
    expected = VerificationResult(missing="network/app", not_counted=not_counted)
    assert verification.result(Off(GRACE_S + STILL_BAD_S), 5.1) == expected
