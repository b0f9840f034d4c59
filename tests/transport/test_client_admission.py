"""Which peers stay on a listening endpoint, without sockets."""

from __future__ import annotations

import pytest
from hypothesis import given, strategies as st

from phm.transport.client_admission import IDLE_S, MAX_PEERS, PER_ADDRESS, PROVE_S, RESERVED, ClientAdmission


def full(admission: ClientAdmission, per_address: int = PER_ADDRESS) -> list[str]:
    """The admitted peers after as many strangers connected as there are places."""
    for key in [f"10.0.0.{n // per_address}:{n}" for n in range(MAX_PEERS)]:
        admission.admit(key, key.partition(":")[0], 0.0)
    return admission.peers


def test_one_address_leaves_places_for_others() -> None:
    """Half of the places at most."""
    admission = ClientAdmission(signs=False)
    came = [n for n in range(100) if admission.admit(n, "10.0.0.1", 0.0) is not None]
    assert came == list(range(PER_ADDRESS))
    assert admission.admit("ground", "10.0.0.2", 0.0) == []


def test_the_oldest_idle_peer_is_displaced() -> None:
    """But not a peer that has just sent something and is the only one of its address."""
    admission = ClientAdmission(signs=False)
    came = full(admission, per_address=1)
    assert len(came) == MAX_PEERS
    for key in came[1:]:
        admission.receive(key, IDLE_S, signed=False)
    assert admission.admit("early", "10.0.1.1", IDLE_S - 0.1) is None
    assert admission.admit("ground", "10.0.1.1", IDLE_S) == [came[0]]
    assert admission.admit("late", "10.0.1.2", IDLE_S) is None


@pytest.mark.parametrize("signs", [True, False])
def test_fast_connections_displace_no_new_peer(signs: bool) -> None:
    """Before it has had time to sign, or at all where none signs: only a peer of the address with most places is
    displaced.
    """
    admission = ClientAdmission(signs=signs, on_trial=signs)
    crowd = [f"10.0.0.{n % 2}:{n}" for n in range(100)]
    for key in crowd:
        admission.admit(key, key.partition(":")[0], 0.0)
    assert len(admission.peers) == MAX_PEERS
    assert admission.admit("ground", "10.0.9.9", 0.1) is not None
    for key in [key for key in crowd if key not in admission]:
        admission.admit(key, key.partition(":")[0], 0.2)
        assert "ground" in admission


def test_active_peers_of_two_addresses_do_not_lock_out_a_third() -> None:
    """The newest peer of the address with most places is displaced, so that the earlier ones stay."""
    admission = ClientAdmission(signs=False)
    came = full(admission)
    for key in came:
        admission.receive(key, 0.5, signed=False)
    assert admission.admit("ground", "10.0.9.9", 0.6) == [came[PER_ADDRESS - 1]]
    assert admission.admit("second", "10.0.9.9", 0.6) == [came[-1]]
    assert admission.admit("back", "10.0.0.0", 0.6) is None


def test_an_idle_peer_of_the_same_address_is_displaced_first() -> None:
    """A restarted ground station connects from another port of the same address."""
    admission = ClientAdmission(signs=False)
    admission.admit("other", "10.0.0.2", 0.0)
    for n in range(PER_ADDRESS):
        admission.admit(n, "10.0.0.1", 1.0)
    assert admission.admit("again", "10.0.0.1", 1.0 + IDLE_S) == [0]


def test_places_are_reserved_for_peers_that_sign() -> None:
    """Whatever unsigned strangers do, a number of peers that sign is admitted beside them, and more instead of them."""
    admission = ClientAdmission(signs=True)
    came = full(admission)
    assert len(came) == MAX_PEERS - RESERVED
    assert [admission.admit(n, "10.0.0.0", 0.0, signed=True) for n in range(RESERVED)] == [[]] * RESERVED
    assert admission.admit("fifth", "10.0.0.0", 0.0, signed=True) == [came[0]]
    assert admission.admit("stranger", "10.0.9.9", 100.0) == [came[1]]
    assert not {0, 1, 2, 3, "fifth"} - set(admission.peers)


def test_a_connection_has_a_reserved_place_until_it_had_time_to_sign() -> None:
    """It can sign only after it was admitted; a peer that does stays, another one is dropped, and the next gets its
    chance.
    """
    admission = ClientAdmission(signs=True, on_trial=True)
    came = full(admission)
    assert len(came) == MAX_PEERS
    trial = admission.peers[-RESERVED:]
    for key in admission.peers:
        admission.receive(key, PROVE_S, signed=key == trial[1])
    assert admission.unproven(PROVE_S) == []
    assert admission.unproven(PROVE_S + 0.1) == [trial[0], *trial[2:]]
    for key in admission.unproven(PROVE_S + 0.1):
        admission.forget(key)
    assert admission.admit("ground", "10.0.9.9", PROVE_S + 0.1) == []


def test_an_ipv6_host_is_identified_by_its_network() -> None:
    """It can use any of 2^64 addresses."""
    admission = ClientAdmission(signs=False)
    came = [n for n in range(100) if admission.admit(n, f"2001:db8::{n:x}", 0.0) is not None]
    assert len(came) == PER_ADDRESS
    assert admission.admit("ground", "fe80::1%eth0", 0.0) == []
    assert admission.admit("mapped", "::ffff:10.0.0.1", 0.0) == []


EVENTS = st.tuples(st.sampled_from(["admit", "receive", "forget"]), st.integers(0, 40), st.booleans(), st.floats(0, 2))


@given(st.lists(EVENTS, max_size=200), st.booleans(), st.booleans())
def test_the_number_of_places_is_limited(
    events: list[tuple[str, int, bool, float]], signs: bool, on_trial: bool
) -> None:
    """Whichever peers connect, sign or become silent."""
    admission, now = ClientAdmission(signs=signs, on_trial=on_trial), 0.0
    for what, key, signed, pause in events:
        now += pause
        if what == "forget":
            admission.forget(key)
        elif key in admission:
            admission.receive(key, now, signed=signed and signs)
        elif what == "admit":
            admission.admit(key, f"10.0.0.{key % 3}", now, signed=signed and signs)
        assert len(admission.peers) <= MAX_PEERS
        assert len(admission._unsigned()) <= MAX_PEERS - (RESERVED if signs and not on_trial else 0)
