"""PHM joins networks: the meaning of the engine's 403."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from phm import testing
from phm.core.settings import ContainerSettings, Settings
from phm.facts import NotPermitted
from phm.recovery.actions.join_network import JoinNetwork, join_networks
from phm.recovery.base import ActionContext, ActionFailed, Target, TargetKind
from phm.runtime.sections import action_settings

APP = ContainerSettings(name="app", networks=["net"])


def context(attached: list[str], **own: Any) -> ActionContext:
    """An engine that rejects connections, with these containers on the network."""

    def refuse(*arguments: Any, **more: Any) -> None:
        raise NotPermitted("the engine answered 403")

    network = {"Id": "n1", "Name": "net", "Containers": {name: {} for name in attached}}
    engine = cast(Any, SimpleNamespace(inspect_network=lambda name: network, connect=refuse, disconnect=refuse))
    me = testing.container("phm", **own)
    return ActionContext(engine, action_settings(Settings()), lambda key: None, lambda: me, lambda key, name: None)


def test_a_network_joined_meanwhile_is_not_a_refusal() -> None:
    """The engine returns 403 for `not allowed` and for `is on it already`; the network itself shows which."""
    assert join_networks(APP, context([testing.container("phm").id])) == ""


def test_a_refusal_by_the_engine_is_reported() -> None:
    """A socket proxy that permits only reading: recovery is not permitted."""
    with pytest.raises(NotPermitted):
        join_networks(APP, context([]))


def test_a_shared_network_namespace_is_not_connected() -> None:
    """The engine refuses to connect PHM then, and the container whose namespace it is may be flight-critical."""
    shared = context([], network_mode="container:app")
    assert join_networks(APP, shared) == ""
    with pytest.raises(ActionFailed, match="shares the network of another container"):
        JoinNetwork().run(Target(TargetKind.CONTAINER, "app", True, APP), cast(Any, None), shared)
