"""The Docker probe: finding containers, facts from patchy answers, sharing answers, PHM's own container."""

from __future__ import annotations

import contextlib
import threading
from pathlib import Path
from typing import Any

import pytest

from phm.core.clock import SystemClock
from phm.facts import CannotTell, HealthcheckFact
from phm.probes.docker import Docker, own_ids
from phm.probes.docker_facts import container_fact
from phm.probes.ping import Pinger
from phm.testing import FakeClock, settings
from phm.transport.docker import DockerEngine
from tests.fakes.engine import FakeEngine, container
from tests.fakes.engine_faults import Hang, Status


def probe(ask: DockerEngine, *containers: dict[str, Any], clock: Any = None, **more: Any) -> Docker:
    chosen = settings(containers=list(containers), **more)
    return Docker(ask, chosen.containers, chosen.docker, clock or FakeClock())


def asked(fake: FakeEngine, call: str) -> int:
    return list(fake.calls).count(call)


def test_a_container_is_found_by_name(fake: FakeEngine, ask: DockerEngine) -> None:
    """The name in the configuration is the container's name."""
    fake.containers["app"] = container("app", status="exited", exit_code=139, networks=["swarm"])
    fact = probe(ask, {"name": "app"}).container("app")
    assert fact is not None
    assert (fact.name, fact.status, fact.exit_code) == ("app", "exited", 139)
    assert [(attached.name, attached.network_id) for attached in fact.networks] == [("swarm", "id-of-swarm")]


def test_a_container_that_is_not_there_is_none(fake: FakeEngine, ask: DockerEngine) -> None:
    """HTTP 404 is an answer, not a failure."""
    assert probe(ask, {"name": "app"}).container("app") is None


def test_the_beginning_of_an_id_is_no_name(fake: FakeEngine, ask: DockerEngine) -> None:
    """The engine takes an id's beginning for a name: that would watch another container."""
    fake.containers["other"] = container("other", container_id="abcdef012345" + "0" * 52)
    assert probe(ask, {"name": "abcdef012345"}).container("abcdef012345") is None


def test_a_label_finds_the_one_container_that_carries_it(fake: FakeEngine, ask: DockerEngine) -> None:
    """Compose makes names; the label of its service is what stays."""
    fake.containers["swarm-app-1"] = container("swarm-app-1", labels={"com.docker.compose.service": "app"})
    fact = probe(ask, {"label": "com.docker.compose.service=app"}).container("app")
    assert fact is not None
    assert fact.name == "swarm-app-1"


def test_the_living_one_of_several_with_a_label_is_meant(fake: FakeEngine, ask: DockerEngine) -> None:
    """A container that was replaced is still listed, stopped, beside its successor."""
    fake.containers["old"] = container("old", status="exited", labels={"role": "app"})
    fake.containers["new"] = container("new", labels={"role": "app"})
    fact = probe(ask, {"label": "role=app"}).container("app")
    assert fact is not None
    assert fact.name == "new"


@pytest.mark.parametrize("status", ["running", "exited"])
def test_a_label_of_several_equal_containers_cannot_be_told(fake: FakeEngine, ask: DockerEngine, status: str) -> None:
    """PHM does not guess, since recovery would act on the guess; it names the candidates."""
    fake.containers["one"] = container("one", status=status, labels={"role": "app"})
    fake.containers["two"] = container("two", status=status, labels={"role": "app"})
    with pytest.raises(CannotTell, match=r"names 2 containers \(one, two\)"):
        probe(ask, {"label": "role=app"}).container("app")


def test_an_unknown_key_is_told(ask: DockerEngine) -> None:
    """Only configured containers can be asked about."""
    with pytest.raises(CannotTell, match="no container nobody is configured"):
        probe(ask).container("nobody")


def test_an_answer_with_little_in_it_is_still_a_fact() -> None:
    """Engines of other versions and makers leave fields out or put null there."""
    fact = container_fact(
        {
            "Id": "a",
            "State": {"Status": "running", "Health": None},
            "NetworkSettings": {"Networks": {"n": None}},
            "Mounts": None,
            "HostConfig": {"Devices": None, "RestartPolicy": None, "Tmpfs": {"/run": ""}},
        }
    )
    assert (fact.health, fact.restart_policy, fact.networks[0].name) == ("none", "no", "n")
    assert [(mount.kind, mount.destination) for mount in fact.mounts] == [("tmpfs", "/run")]


def test_a_full_answer_is_read_in_full() -> None:
    """Health with its last output, fixed address, devices and mounts are part of the fact."""
    told = container(
        "app",
        networks=["swarm"],
        mounts=[{"Type": "volume", "Name": "v", "Source": "/s", "Destination": "/d", "RW": False}],
    )
    told["State"]["Health"] = {
        "Status": "unhealthy",
        "FailingStreak": 4,
        "Log": [{"Output": "old"}, {"Output": "no\n node "}],
    }
    told["NetworkSettings"]["Networks"]["swarm"]["IPAMConfig"] = {"IPv4Address": "10.9.0.2"}
    told["HostConfig"]["Devices"] = [{"PathOnHost": "/dev/a", "PathInContainer": "/dev/b", "CgroupPermissions": "r"}]
    fact = container_fact(told)
    assert (fact.health, fact.health_streak, fact.health_output) == ("unhealthy", 4, "no node")
    assert fact.networks[0].fixed_address == "10.9.0.2"
    assert (fact.mounts[0].name, fact.mounts[0].writable) == ("v", False)
    assert (fact.devices[0].host_path, fact.devices[0].container_path) == ("/dev/a", "/dev/b")


SECOND = 10**9


@pytest.mark.parametrize(
    ("given", "read"),
    [
        (None, None),
        ({}, None),
        ({"Test": ["NONE"]}, None),
        ({"Test": ["CMD", "true"]}, HealthcheckFact(30.0, 30.0, 0.0, 5.0, 3)),
        ({"Test": ["CMD-SHELL", "x"], "Interval": 0, "Retries": 0}, HealthcheckFact(30.0, 30.0, 0.0, 5.0, 3)),
        (
            {
                "Test": ["CMD", "x"],
                "Interval": 60 * SECOND,
                "Timeout": 2 * SECOND,
                "StartPeriod": 90 * SECOND,
                "StartInterval": SECOND,
                "Retries": 5,
            },
            HealthcheckFact(60.0, 2.0, 90.0, 1.0, 5),
        ),
        ({"Test": ["CMD", "x"], "Interval": "often"}, HealthcheckFact()),
    ],
)
def test_a_healthcheck_has_the_engines_defaults_where_nothing_is_set(
    given: dict[str, Any] | None, read: HealthcheckFact | None
) -> None:
    """Nanoseconds; 0 stands for the default, and the test NONE for no health check."""
    answer = {**container("app"), "Config": {"Healthcheck": given}}
    assert container_fact(answer).healthcheck == read


def test_an_answer_without_a_state_cannot_be_told() -> None:
    """A container without a state is the engine's fault, not a stopped container."""
    with pytest.raises(CannotTell):
        container_fact({"Id": "a"})


def test_checks_that_ask_together_share_one_answer(fake: FakeEngine, ask: DockerEngine) -> None:
    """At one moment the engine is asked once; whoever asks later gets an answer from after its question."""
    fake.containers["app"] = container("app")
    clock = FakeClock()
    docker = probe(ask, {"name": "app"}, clock=clock)
    docker.container("app")
    docker.container("app")
    assert asked(fake, "GET /containers/app/json") == 1
    clock.advance(0.01)
    docker.container("app")
    assert asked(fake, "GET /containers/app/json") == 2


def test_an_answer_from_before_the_question_is_not_shared(fake: FakeEngine, ask: DockerEngine) -> None:
    """A container that has ended without an event since somebody else asked is seen to have ended: the run began after it."""
    fake.containers["app"] = container("app")
    clock = FakeClock()
    docker = probe(ask, {"name": "app"}, clock=clock)
    docker.container("app")
    fake.set("app", status="exited", silently=True)
    clock.advance(0.05)
    fact = docker.container("app")
    assert fact is not None
    assert fact.status == "exited"


def test_a_list_of_processes_asks_for_the_container_no_second_time(fake: FakeEngine, ask: DockerEngine) -> None:
    """The check has just looked at the container, and its processes are those of that id, or the engine refuses."""
    fake.containers["app"] = container("app")
    clock = FakeClock()
    docker = probe(ask, {"name": "app"}, clock=clock)
    docker.container("app")
    clock.advance(0.05)
    with contextlib.suppress(CannotTell):
        docker.processes("app")
    assert asked(fake, "GET /containers/app/json") == 1


def test_an_event_makes_the_shared_answer_old(fake: FakeEngine, ask: DockerEngine) -> None:
    """After an event nobody gets the state from before it."""
    fake.containers["app"] = container("app")
    docker = probe(ask, {"name": "app"})
    docker.container("app")
    fake.set("app", status="exited")
    docker.invalidate()
    fact = docker.container("app")
    assert fact is not None
    assert fact.status == "exited"


def test_those_who_waited_for_a_hanging_engine_do_not_wait_again(fake: FakeEngine) -> None:
    """Five checks on a hung engine end together, not one time-out after the other."""
    engine = DockerEngine(fake.url, timeout_s=1.0)
    docker = probe(engine, {"name": "app"}, clock=SystemClock())
    engine.version()
    fake.fault = Hang(route="/app/")
    told: list[str] = []

    def look() -> None:
        try:
            docker.container("app")
        except CannotTell as error:
            told.append(str(error))

    threads = [threading.Thread(target=look) for _ in range(5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(20)
    assert len(told) == 5
    assert asked(fake, "GET /containers/app/json") == 1
    engine.close()


def test_a_network_has_an_id_or_does_not_exist(fake: FakeEngine, ask: DockerEngine) -> None:
    """A network that is gone is an empty id, and a failure is no answer."""
    fake.networks["swarm"] = {"Id": "n1"}
    docker = probe(ask)
    assert docker.network_id("swarm") == "n1"
    assert docker.network_id("other") == ""
    fake.fault = Status(500)
    with pytest.raises(CannotTell):
        docker.network_id("swarm")


def test_the_engine_tells_its_version(ask: DockerEngine) -> None:
    """`engine` proves that the engine answers."""
    assert probe(ask).engine() == "20.10.24"


MINE, OTHER = "a1" * 32, "b2" * 32


def proc(tmp_path: Path, mountinfo: str = "", cgroup: str = "") -> Path:
    (tmp_path / "mountinfo").write_text(mountinfo)
    (tmp_path / "cgroup").write_text(cgroup)
    return tmp_path


def test_own_id_comes_from_the_files_that_the_engine_mounts(tmp_path: Path) -> None:
    """Under cgroup v2 only the source of /etc/hostname names the container."""
    line = f"269 252 254:0 /var/lib/docker/containers/{MINE}/hostname /etc/hostname rw - ext4 /dev/vda rw\n"
    assert own_ids(proc(tmp_path, line, "0::/\n"))[0] == MINE


def test_own_id_comes_from_the_cgroup(tmp_path: Path) -> None:
    """Under cgroup v1 each path names it."""
    assert MINE in own_ids(proc(tmp_path, cgroup=f"7:blkio:/docker/{MINE}\n"))


def test_a_host_is_none_of_its_containers(tmp_path: Path) -> None:
    """A host's mount table names all containers: none of them is PHM."""
    line = f"99 24 0:50 / /var/lib/docker/containers/{OTHER}/mounts/shm rw - tmpfs shm rw\n"
    assert OTHER not in own_ids(proc(tmp_path, line, "0::/user.slice\n"))


def test_own_container_is_believed_only_when_the_engine_knows_it(
    fake: FakeEngine, ask: DockerEngine, tmp_path: Path
) -> None:
    """Inside another engine's container (a CI job) the id means nothing to this engine."""
    place = proc(tmp_path, cgroup=f"7:blkio:/docker/{OTHER}/docker/{MINE}\n")
    docker = Docker(ask, [], settings().docker, FakeClock(), proc=place)
    assert docker.myself() is None
    fake.containers["phm"] = container("phm", container_id=MINE)
    docker.invalidate()
    fact = docker.myself()
    assert fact is not None
    assert fact.name == "phm"


def test_a_configured_own_container_must_exist(fake: FakeEngine, ask: DockerEngine) -> None:
    """A wrong `docker.container` is said, not taken for `not in a container`."""
    docker = probe(ask, docker={"container": "phm_1"})
    with pytest.raises(CannotTell, match="phm_1"):
        docker.myself()
    fake.containers["phm_1"] = container("phm_1")
    docker.invalidate()
    assert docker.myself() is not None


@pytest.mark.parametrize("address", ["127.0.0.1", "::1"])
def test_this_machine_answers(ask: DockerEngine, address: str) -> None:
    """A closed port that refuses is proof that the address answers."""
    assert probe(ask).reachable(address)


def test_who_has_answered_and_no_longer_does_is_silent() -> None:
    """ARP remembers a neighbour that is gone for up to a minute; it speaks only for who has never answered in this life."""
    there = True
    reach = Pinger(ping=lambda _, limit_s: there, known=lambda _: True)
    assert reach.answers("10.0.0.2", "first life")
    there = False
    assert not reach.answers("10.0.0.2", "first life")
    assert reach.answers("10.0.0.2", "second life"), "a firewall swallows what we send"
    assert reach.answers("10.0.0.3")


def test_no_address_cannot_be_told(ask: DockerEngine) -> None:
    """A name is not looked up: that would need a deadline of its own."""
    with pytest.raises(CannotTell, match="not an IP address"):
        probe(ask).reachable("ros_app")
