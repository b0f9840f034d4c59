"""The application is restarted from outside: its nodes raise no alarm, and a crash loop is one fault."""

from __future__ import annotations

import contextlib
import io
import tarfile
import uuid
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from docker import DockerClient
from docker.errors import APIError
from docker.models.containers import Container

from tests.system.conftest import APP_IMAGE, AppContainer, Phm, config_for, poll

AFTER_S = 14.0
"""Longer than nodes and topics need on an idle machine; at the end, all must be OK."""
LOOPS = 6
"""Restarts to watch: several times as many as define a crash loop."""
LIVES_2_S = "test -e /tmp/fixed && exec sleep 600; sleep 2; exit 3"


def state(container: Container) -> tuple[str, int]:
    container.reload()
    return container.attrs["State"]["StartedAt"], container.attrs["RestartCount"]


def kill_first_process(client: DockerClient, container: Container) -> None:
    """From outside its namespace, where its first process can be killed: Docker then applies the restart policy."""
    container.reload()
    pid = str(container.attrs["State"]["Pid"])
    client.containers.run(APP_IMAGE, ["kill", "-KILL", pid], pid_mode="host", user="root", network="none", remove=True)


def observe(phm: Phm, seconds: float) -> None:
    """Observe the log for this time."""
    mark = phm.mark()
    until = phm.record.events[-1]["mono"] + seconds
    phm.wait(lambda event: event["mono"] >= until, "the log going on", since=mark)


def with_long_limits(app: AppContainer, **more: Any) -> dict[str, Any]:
    """On a busy machine, whose load is not observed here, nodes may need longer to start than the default allows."""
    config = config_for(app, **more)
    config["ros"]["grace"] = "30s"
    return config


def test_a_crash_that_docker_recovers_raises_no_alarm_inside(
    app: AppContainer, docker_client: DockerClient, start_phm: Callable[..., Phm]
) -> None:
    """The policy restarts it within a tenth of a second: a warning at the container, and nothing for nodes or topics."""
    app.container.update(restart_policy={"Name": "always"})
    phm = start_phm(with_long_limits(app), app.domain)
    phm.wait_all_ok()
    mark, before = phm.mark(), state(app.container)
    kill_first_process(docker_client, app.container)
    poll(lambda: state(app.container)[0] > before[0], "the restart by Docker")
    phm.wait(
        lambda event: event["event"] == "transition" and event["condition"] == "restarted", "the warning", since=mark
    )
    observe(phm, AFTER_S)
    assert phm.opened(mark) == []
    published = [
        (event["unit"], event["level"], event["condition"])
        for event in phm.record.events[mark:]
        if event["event"] == "transition"
        and event["level"] in ("WARN", "ERROR")
        # A busy machine may starve it while it starts.
        and not event["unit"].startswith("pressure/")
    ]
    assert published == [(f"container/{app.name}", "WARN", "restarted")]
    phm.wait_all_ok(phm.mark())


@pytest.mark.long
def test_a_restart_by_the_operator_raises_no_alarm_inside(app: AppContainer, start_phm: Callable[..., Phm]) -> None:
    """`docker restart`, twice, with a stop timeout of zero; only the container itself may be reported down."""
    phm = start_phm(with_long_limits(app, recovery={"mode": "off"}), app.domain)
    phm.wait_all_ok()
    mark = phm.mark()
    for _ in range(2):
        app.container.restart(timeout=0)
        observe(phm, AFTER_S)
    assert set(phm.opened(mark)) <= {f"container/{app.name}"}
    phm.wait_all_ok(phm.mark())


@pytest.mark.long
def test_a_crash_loop_is_one_fault_until_the_application_stays_up(
    app: AppContainer, docker_client: DockerClient, start_phm: Callable[..., Phm]
) -> None:
    """Each start gives grace to the nodes inside; the loop is still reported, once, and at the container."""
    app.container.update(restart_policy={"Name": "always"})
    phm = start_phm(config_for(app), app.domain)
    phm.wait_all_ok()
    mark, unit = phm.mark(), f"container/{app.name}"
    app.run("sh", "-c", "echo 1 >/tmp/broken_start")
    kill_first_process(docker_client, app.container)
    poll(lambda: state(app.container)[1] >= LOOPS, f"{LOOPS} restarts by Docker")
    app.container.put_archive("/tmp", empty_file("broken_start"))
    closed = phm.wait(lambda event: event["event"] == "fault_closed", "the end of the fault", 180.0, mark)
    observe(phm, AFTER_S)
    assert phm.opened(mark) == [unit]
    assert (closed["unit"], closed["condition"], closed["outcome"]) == (unit, "restarting", "resolved")
    phm.wait_all_ok(phm.mark())


@pytest.fixture
def short_lived(docker_client: DockerClient) -> Iterator[Container]:
    """A container whose process ends after two seconds until it is fixed, and that Docker restarts."""
    made = docker_client.containers.run(
        APP_IMAGE,
        ["sh", "-c", LIVES_2_S],
        name=f"phm-test-{uuid.uuid4().hex[:8]}",
        detach=True,
        network="none",
        restart_policy={"Name": "always"},
        labels={"phm.test": "1"},
        stop_signal="SIGKILL",
    )
    try:
        yield made
    finally:
        made.remove(force=True)


@pytest.mark.long
def test_a_process_that_repeatedly_ends_after_two_seconds_is_one_fault(
    short_lived: Container, start_phm: Callable[..., Phm]
) -> None:
    """Mostly seen running; the fault stays open in between, and closes when one run has lasted long enough."""
    containers = [{"name": short_lived.name, "healthcheck": "ignore"}]
    # The load of the machine that runs the tests is not under test.
    phm = start_phm({"interval": "3s", "containers": containers, "checks": {"host": {"enabled": False}}})
    opened = phm.wait(lambda event: event["event"] == "fault_opened", "the fault")
    assert (opened["unit"], opened["condition"]) == (f"container/{short_lived.name}", "restarting")
    poll(lambda: state(short_lived)[1] >= LOOPS, f"{LOOPS} restarts by Docker")
    assert phm.opened(0) == [opened["unit"]]
    assert not [event for event in phm.record.events if event["event"] == "fault_closed"]

    def fix() -> bool:
        with contextlib.suppress(APIError):  # it runs for two seconds and waits longer than that
            return bool(short_lived.exec_run(["touch", "/tmp/fixed"]).exit_code == 0)
        return False

    poll(fix, "a moment in which it runs")
    fixed = phm.mark()
    closed = phm.wait(lambda event: event["event"] == "fault_closed", "the end of the fault", 180.0, fixed)
    assert (closed["outcome"], closed["by"]) == ("resolved", "itself")
    assert phm.opened(0) == [opened["unit"]]


def empty_file(name: str) -> bytes:
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w") as tar:
        tar.addfile(tarfile.TarInfo(name))
    return archive.getvalue()
