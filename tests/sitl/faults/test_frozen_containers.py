"""Faults that freeze a container or replace it with a copy: on a busy engine they fail cleanly, or not at all."""

from __future__ import annotations

from unittest import mock

import pytest
from docker.errors import APIError

from sitl.faults import base, node_never_started
from sitl.faults.base import FREEZES, Agent, freeze

UNABLE = APIError("Cannot pause container 1: OCI runtime pause failed: unable to freeze: unknown")


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(base, "FREEZE_AGAIN_S", 0.0)


def container(*answers: object) -> mock.Mock:
    return mock.Mock(pause=mock.Mock(side_effect=answers))


def test_a_container_that_the_kernel_does_not_freeze_in_time_is_paused_again() -> None:
    """Seen on a machine with a load of 40."""
    made = container(UNABLE, UNABLE, None)
    freeze(made)
    assert made.pause.call_count == 3


@pytest.mark.parametrize(("error", "calls"), [(UNABLE, FREEZES), (APIError("is not running"), 1)])
def test_a_container_that_cannot_be_paused_is_reported(error: APIError, calls: int) -> None:
    """After FREEZES attempts, and immediately when a retry would not help."""
    made = container(*[error] * FREEZES)
    with pytest.raises(APIError):
        freeze(made)
    assert made.pause.call_count == calls


def test_a_copy_that_could_not_replace_the_application_is_removed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its nodes would run beside those of the application."""
    copy, agent = mock.Mock(), mock.Mock(spec=Agent)
    agent.sidecar = container(APIError("is not running"))
    monkeypatch.setattr(node_never_started, "copied", lambda agent, old: copy)
    monkeypatch.setattr(node_never_started, "put", lambda *words: None)
    with pytest.raises(APIError):
        node_never_started.Injection().inject(agent)
    copy.remove.assert_called_once_with(force=True)
    agent.app.rename.assert_not_called()
