"""Faults that freeze a container or replace it with a copy: on a busy engine they fail cleanly, or not at all."""

from __future__ import annotations

from typing import Any
from unittest import mock

import pytest
from docker.errors import APIError

from sitl.faults import base, container_created, node_never_started
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


@pytest.fixture(params=[container_created, node_never_started])
def fault(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A fault that replaces the application's container with `fault.copy`, on `fault.agent`; `fault.calls` has all calls."""
    calls = mock.Mock()
    agent = mock.Mock(spec=Agent, app=calls.old, sidecar=calls.sidecar)
    calls.old.name, calls.old.attrs = "app", {"Id": "1"}
    monkeypatch.setattr(request.param, "copied", lambda agent, old: calls.copy)
    monkeypatch.setattr(node_never_started, "put", lambda *words: None)
    return mock.Mock(inject=request.param.Injection().inject, agent=agent, copy=calls.copy, calls=calls)


def test_phm_is_frozen_while_a_copy_takes_the_name_of_the_application(fault: Any) -> None:
    """Else it reports within 0.06 s that the container does not exist, which is true and not the fault."""
    fault.inject(fault.agent)
    names = [name for name, _, _ in fault.calls.mock_calls]
    assert names[-5:] == ["sidecar.pause", "old.rename", "copy.rename", "sidecar.unpause", "old.remove"]


def test_a_copy_that_could_not_replace_the_application_is_removed(fault: Any) -> None:
    """Its nodes would run beside those of the application."""
    fault.agent.sidecar.pause.side_effect = APIError("is not running")
    with pytest.raises(APIError):
        fault.inject(fault.agent)
    fault.copy.remove.assert_called_once_with(force=True)
    fault.agent.app.rename.assert_not_called()
