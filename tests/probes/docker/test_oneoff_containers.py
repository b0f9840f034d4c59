"""Containers of `docker compose run SERVICE` have the labels of the service, and are not the service's container."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.core.settings import ContainerSettings
from phm.facts import CannotTell
from phm.logs.containers import reference
from phm.probes.docker_facts import TimeBudget, find, is_configured
from phm.probes.event_decoder import EventDecoder
from phm.testing import FakeClock, settings
from phm.transport.docker import DockerEngine
from tests.fakes.engine import FakeEngine, container

SERVICE = {"com.docker.compose.service": "autonomy"}
APP, SHELL = "robot-autonomy-1", "robot-autonomy-run-1f2e"
ONEOFF = "com.docker.compose.oneoff"
BY_LABEL = {"label": "com.docker.compose.service=autonomy"}
TRUE = pytest.mark.parametrize("true", ["True", "true", "TRUE"])


def entry_of(**entry: str) -> ContainerSettings:
    (made,) = settings(containers=[entry]).containers
    return made


def found(ask: DockerEngine, **entry: str) -> str:
    """The name of the container that the entry names; empty: none."""
    fact = find(ask, entry_of(**entry), TimeBudget(SystemClock(), 30.0))
    return fact.name if fact is not None else ""


def event(action: str, name: str, labels: Mapping[str, str], **more: str) -> dict[str, Any]:
    attributes = {"name": name, **labels, **more}
    return {"Type": "container", "Action": action, "Actor": {"ID": f"id-of-{name}", "Attributes": attributes}}


@TRUE
@pytest.mark.parametrize("status", ["running", "exited"])
def test_a_shell_beside_the_service_is_not_found_by_its_label(
    fake: FakeEngine, ask: DockerEngine, true: str, status: str
) -> None:
    """Neither makes it ambiguous while the service's container runs, nor takes its place when that has crashed."""
    fake.containers[APP] = container(APP, status=status, labels={**SERVICE, ONEOFF: "False"})
    fake.containers[SHELL] = container(SHELL, labels={**SERVICE, ONEOFF: true})
    assert found(ask, **BY_LABEL) == APP
    assert reference(ask, entry_of(**BY_LABEL)) == fake.containers[APP]["Id"]
    del fake.containers[APP]
    assert found(ask, **BY_LABEL) == ""


def test_a_shell_is_found_by_its_name_and_by_the_label_of_shells(fake: FakeEngine, ask: DockerEngine) -> None:
    """Who configures it means it."""
    fake.containers[SHELL] = container(SHELL, labels={**SERVICE, ONEOFF: "True"})
    assert found(ask, name=SHELL) == found(ask, label=f"{ONEOFF}=True") == found(ask, label=ONEOFF) == SHELL


def test_two_containers_of_a_service_are_still_ambiguous(fake: FakeEngine, ask: DockerEngine) -> None:
    """`docker compose up --scale autonomy=2`."""
    for name in (APP, "robot-autonomy-2"):
        fake.containers[name] = container(name, labels={**SERVICE, ONEOFF: "False"})
    with pytest.raises(CannotTell, match="names 2 containers"):
        found(ask, **BY_LABEL)


@TRUE
def test_a_shell_is_not_the_configured_container_in_the_list_of_the_engine(true: str) -> None:
    """As in the list of the containers that run beside the configured ones."""
    listed = {"Names": [f"/{SHELL}"], "Labels": {**SERVICE, ONEOFF: true}}
    assert not is_configured(entry_of(**BY_LABEL), listed)
    assert is_configured(entry_of(name=SHELL), listed) and is_configured(entry_of(label=ONEOFF), listed)
    assert is_configured(entry_of(**BY_LABEL), {"Names": [f"/{APP}"], "Labels": {**SERVICE, ONEOFF: "False"}})


@TRUE
def test_events_of_a_shell_are_not_those_of_the_service(true: str) -> None:
    """Its start does not replace the service's container, whose crash would be dropped then as that of an old one."""
    decoder = EventDecoder([entry_of(**BY_LABEL)], FakeClock())
    app, shell = {**SERVICE, ONEOFF: "False"}, {**SERVICE, ONEOFF: true}
    started = decoder.decode(event("start", APP, app))
    assert started is not None and (started.key, started.action) == ("autonomy", "start")
    for action in ("create", "start", "kill", "die", "destroy"):
        assert decoder.decode(event(action, SHELL, shell, signal="9", exitCode="1")) is None
        crashed = decoder.decode(event("die", APP, app, exitCode="139"))
        assert crashed is not None and (crashed.key, crashed.detail) == ("autonomy", "exit code 139")
