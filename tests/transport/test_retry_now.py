"""The container at the other end of a link: its exit is reported as the cause, and its start reopens the link
immediately.
"""

from __future__ import annotations

import socket

import pytest

from phm.testing import FakeClock, settings
from phm.transport.mavlink import MavlinkHub
from phm_checks.link import Link
from tests.fakes.mavlink import free_port
from tests.fakes.until import until


@pytest.mark.parametrize("container", ["router", "other"])
def test_a_link_is_tried_immediately_when_its_container_was_started(container: str) -> None:
    """Not when another container was. The clock does not move here, so the back-off alone would never expire."""
    port, clock = free_port(), FakeClock()
    made = settings(
        containers=[{"name": "router"}, {"name": "other"}],
        mavlink={"endpoints": [{"url": f"tcp:127.0.0.1:{port}", "name": "router", "container": "router"}]},
    )
    hub = MavlinkHub(made.mavlink, 7, clock)
    hub.start()
    try:
        until(lambda: bool(hub.links()), "the first attempt")
        clock.wait_for_sleepers(1, 60.0)
        with socket.create_server(("127.0.0.1", port)) as door:
            hub.retry_now(container)
            door.settimeout(60.0 if container == "router" else 0.3)
            if container == "router":
                door.accept()[0].close()
            else:
                with pytest.raises(TimeoutError):
                    door.accept()
    finally:
        hub.close()


def test_a_link_depends_on_the_container_at_its_other_end() -> None:
    """Consequences of its exit are not reported separately."""
    made = settings(
        containers=[{"name": "mavlink-router", "alias": "router"}],
        mavlink={
            "endpoints": [
                {"url": "tcp:router:5760", "name": "one", "container": "router"},
                {"url": "tcp:pilot:5760", "name": "two"},
            ]
        },
    )
    needs = [check.units[0].needs for check in Link.build(made)]
    assert needs == [("container/router",), ()]
