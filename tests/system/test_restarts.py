"""Somebody else restarts the application: what runs in it raises no alarm, and a crash loop is one fault."""

from __future__ import annotations

import contextlib
import io
import tarfile
import uuid
from collections.abc import Callable, Iterator

import pytest
from docker import DockerClient
from docker.errors import APIError
from docker.models.containers import Container

from tests.system.conftest import APP_IMAGE, Aboard, Phm, config_for, poll

AFTER_S = 14.0
"""Longer than the grace of any unit, so that late alarms are caught."""
LOOPS = 6
"""Restarts to watch: several times what it takes to call it a loop."""
LIVES_2_S = "test -e /tmp/mended && exec sleep 600; sleep 2; exit 3"


def state(container: Container) -> tuple[str, int]:
    container.reload()
    return container.attrs["State"]["StartedAt"], container.attrs["RestartCount"]


def kill_first_process(client: DockerClient, container: Container) -> None:
    """From outside of its namespace, where the first process can be killed: Docker then applies its restart policy."""
    container.reload()
    pid = str(container.attrs["State"]["Pid"])
    client.containers.run(APP_IMAGE, ["kill", "-KILL", pid], pid_mode="host", user="root", network="none", remove=True)


def watch(phm: Phm, seconds: float) -> None:
    """Let the log go on for so long."""
    mark = phm.mark()
    until = phm.record.events[-1]["mono"] + seconds
    phm.wait(lambda event: event["mono"] >= until, "the log going on", 2 * seconds + 10, mark)


def test_a_crash_that_docker_heals_raises_no_alarm_inside(
    app: Aboard, docker_client: DockerClient, start_phm: Callable[..., Phm]
) -> None:
    """The policy restarts it within a tenth of a second: a warning at the container, and nothing for nodes or topics."""
    app.container.update(restart_policy={"Name": "always"})
    phm = start_phm(config_for(app), app.domain)
    phm.wait_all_well()
    mark, before = phm.mark(), state(app.container)
    kill_first_process(docker_client, app.container)
    poll(lambda: state(app.container)[0] > before[0], "the restart by Docker")
    watch(phm, AFTER_S)
    assert phm.opened(mark) == []
    told = [
        (event["unit"], event["level"], event["condition"])
        for event in phm.record.events[mark:]
        if event["event"] == "transition" and event["level"] in ("WARN", "ERROR")
    ]
    assert told == [(f"container/{app.name}", "WARN", "restarted")]
    phm.wait_all_well(phm.mark())


def test_a_restart_by_the_operator_raises_no_alarm_inside(app: Aboard, start_phm: Callable[..., Phm]) -> None:
    """`docker restart`, twice, without time to say goodbye; only the container itself may be seen down."""
    phm = start_phm(config_for(app, recovery={"mode": "off"}), app.domain)
    phm.wait_all_well()
    mark = phm.mark()
    for _ in range(2):
        app.container.restart(timeout=0)
        watch(phm, AFTER_S)
    assert set(phm.opened(mark)) <= {f"container/{app.name}"}
    phm.wait_all_well(phm.mark())


def test_a_crash_loop_is_one_fault_and_over_when_the_application_stays(
    app: Aboard, docker_client: DockerClient, start_phm: Callable[..., Phm]
) -> None:
    """Each start gives grace to the nodes inside; the loop is told all the same, once, and at the container."""
    app.container.update(restart_policy={"Name": "always"})
    phm = start_phm(config_for(app), app.domain)
    phm.wait_all_well()
    mark, unit = phm.mark(), f"container/{app.name}"
    app.run("sh", "-c", "echo 1 >/tmp/broken_start")
    kill_first_process(docker_client, app.container)
    poll(lambda: state(app.container)[1] >= LOOPS, f"{LOOPS} restarts by Docker", 60.0)
    app.container.put_archive("/tmp", empty_file("broken_start"))
    closed = phm.wait(lambda event: event["event"] == "fault_closed", "the end of the fault", 60.0, mark)
    watch(phm, AFTER_S)
    assert phm.opened(mark) == [unit]
    assert (closed["unit"], closed["condition"], closed["outcome"]) == (unit, "restarting", "resolved")
    phm.wait_all_well(phm.mark())


@pytest.fixture
def short_lived(docker_client: DockerClient) -> Iterator[Container]:
    """A container whose process ends after two seconds, until it is mended, and that Docker restarts."""
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


def test_a_process_that_lives_two_seconds_is_one_fault(short_lived: Container, start_phm: Callable[..., Phm]) -> None:
    """Mostly seen running; the fault stays open in between, and is over when one life has lasted."""
    phm = start_phm({"interval": "3s", "containers": [{"name": short_lived.name, "healthcheck": "ignore"}]})
    opened = phm.wait(lambda event: event["event"] == "fault_opened", "the fault", 60.0)
    assert (opened["unit"], opened["condition"]) == (f"container/{short_lived.name}", "restarting")
    poll(lambda: state(short_lived)[1] >= LOOPS, f"{LOOPS} restarts by Docker", 60.0)
    assert phm.opened(0) == [opened["unit"]]
    assert not [event for event in phm.record.events if event["event"] == "fault_closed"]

    def mend() -> bool:
        with contextlib.suppress(APIError):  # it runs for two seconds and waits for longer
            return bool(short_lived.exec_run(["touch", "/tmp/mended"]).exit_code == 0)
        return False

    poll(mend, "a moment in which it runs", 60.0)
    mended = phm.mark()
    closed = phm.wait(lambda event: event["event"] == "fault_closed", "the end of the fault", 90.0, mended)
    assert (closed["outcome"], closed["by"]) == ("resolved", "itself")
    assert phm.opened(0) == [opened["unit"]]


def empty_file(name: str) -> bytes:
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w") as tar:
        tar.addfile(tarfile.TarInfo(name))
    return archive.getvalue()
