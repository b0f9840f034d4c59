"""Static peers that cannot be resolved yet."""

from __future__ import annotations

import threading

import pytest

from phm.probes.ros.static_peers import StaticPeers
from tests.fakes.until import until

LIMIT_S = 60.0


def test_a_peer_that_cannot_be_resolved_is_left_out_until_it_can() -> None:
    """rmw_fastrtps would create no participant because of it."""
    known, environ = {"app"}, {"ROS_STATIC_PEERS": "app;late"}

    def resolve(name: str) -> str:
        if name not in known:
            raise OSError
        return "10.0.0.1"

    peers = StaticPeers(environ, resolve, retry_s=0.01, wait_s=LIMIT_S)
    assert environ["ROS_STATIC_PEERS"] == "app" and peers.missing == ("late",)
    assert not peers.more()
    known.add("late")
    until(peers.more, "the second peer")
    assert environ["ROS_STATIC_PEERS"] == "app;late" and not peers.missing and not peers.more()


def test_a_resolver_that_hangs_delays_no_other_peer_and_not_the_start() -> None:
    """Without a network, a resolver takes seconds for each name; PHM observes meanwhile."""
    answer, gave_up, environ = threading.Event(), list[str](), {"ROS_STATIC_PEERS": "app;slow"}

    def resolve(name: str) -> str:
        if name == "slow" and not answer.wait(LIMIT_S):
            gave_up.append(name)
        return "10.0.0.1"

    peers = StaticPeers(environ, resolve, wait_s=0.01)
    until(lambda: peers.more() or environ["ROS_STATIC_PEERS"] == "app", "the first peer")
    assert peers.missing == ("slow",) and not gave_up
    answer.set()
    until(peers.more, "the second peer")
    assert environ["ROS_STATIC_PEERS"] == "app;slow"


@pytest.mark.parametrize("name", ["no.such.host.invalid", "a..b"])
def test_a_name_that_is_none_is_left_out(name: str) -> None:
    """As the resolver of this machine says."""
    environ = {"ROS_STATIC_PEERS": f"127.0.0.1;{name}"}
    peers = StaticPeers(environ, wait_s=LIMIT_S)
    assert peers.missing == (name,)
    assert environ["ROS_STATIC_PEERS"] == "127.0.0.1"


def test_with_the_range_localhost_the_variable_stays_unchanged() -> None:
    """The profile has the addresses then."""
    environ = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "late"}
    assert not StaticPeers(environ).missing and environ["ROS_STATIC_PEERS"] == "late"
