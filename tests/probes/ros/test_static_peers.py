"""Static peers that cannot be resolved yet."""

from __future__ import annotations

import pytest

from phm.probes.ros.static_peers import StaticPeers
from tests.fakes.until import until


def test_a_peer_that_cannot_be_resolved_is_left_out_until_it_can() -> None:
    """rmw_fastrtps would create no participant because of it."""
    known, environ = {"app"}, {"ROS_STATIC_PEERS": "app;late"}

    def resolve(name: str) -> str:
        if name not in known:
            raise OSError
        return "10.0.0.1"

    peers = StaticPeers(environ, resolve, retry_s=0.01)
    assert environ["ROS_STATIC_PEERS"] == "app" and peers.missing == ("late",)
    peers.start()
    assert not peers.more()
    known.add("late")
    until(peers.more, "the second peer")
    assert environ["ROS_STATIC_PEERS"] == "app;late" and not peers.missing and not peers.more()


@pytest.mark.parametrize("name", ["no.such.host.invalid", "a..b"])
def test_a_name_that_is_none_is_left_out(name: str) -> None:
    """As the resolver of this machine says."""
    environ = {"ROS_STATIC_PEERS": f"127.0.0.1;{name}"}
    assert StaticPeers(environ).missing == (name,)
    assert environ["ROS_STATIC_PEERS"] == "127.0.0.1"


def test_with_the_range_localhost_the_variable_stays_unchanged() -> None:
    """The profile has the addresses then."""
    environ = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "late"}
    assert not StaticPeers(environ).missing and environ["ROS_STATIC_PEERS"] == "late"
