"""The last sentence of `phm report`: what to do before the next flight."""

from __future__ import annotations

import pytest

from phm.review.sentences import _next
from phm_checks.container import code_in_words


@pytest.mark.parametrize(
    "summary",
    [
        f"ros_app exited with code 1 ({code_in_words(1)}), expected running. `docker logs ros_app` says why",
        f"ros_app exited with code 137 ({code_in_words(137)}: by hand), expected running. `docker logs ros_app` says why",
        "health check of ros_app failed 3 times, expected healthy. Last output: none. `docker inspect ros_app` shows the earlier ones",
        "health check of ros_app failed 3 times, expected healthy. Last output: curl: refused. `docker inspect ros_app` shows more",
        "camera: 192.168.1.20 port 554: connection refused, expected a connection. Check the camera's power and cable.",
        "page: http://192.168.1.20/state: recording is false, expected true. Check the SD card of the camera.",
    ],
)
def test_a_colon_before_something_else_than_advice(summary: str) -> None:
    """What was found may have colons, too; then the sentence names the unit."""
    assert (
        said(summary)
        == "Before the next flight, on agent_1 (container/ros_app): look at container/ros_app: ros_app exited."
    )
    assert said(summary, brief="").endswith(": look at container/ros_app.")


def test_the_advice_follows_what_was_expected() -> None:
    """A decimal point ends no sentence."""
    assert said("/a/b does not match: 1 of 2, expected at most 0.5 %: restart it and check its log.").endswith(
        "(container/ros_app): restart it and check its log."
    )


def said(summary: str, brief: str = "ros_app exited") -> str:
    fault = {
        "agent": "agent_1",
        "unit": "container/ros_app",
        "outcome": "escalated",
        "ok_again": None,
        "summary": summary,
        "brief": brief,
    }
    return _next({"faults": [{**fault, "by": "", "opened": 0}], "agents": []})
