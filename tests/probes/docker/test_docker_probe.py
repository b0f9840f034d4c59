"""The Docker probe: finding containers, facts from incomplete responses, PHM's own container."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from phm.facts import CannotTell, HealthcheckFact
from phm.probes.attachment_cache import AttachmentCache
from phm.probes.docker import Docker, own_ids
from phm.probes.docker_facts import DEPENDS_ON, container_fact
from phm.probes.ping import Pinger
from phm.testing import FakeClock, settings
from phm.transport.docker import DockerEngine
from tests.fakes.engine import FakeEngine, container
from tests.fakes.engine_faults import Status


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


def test_a_container_that_does_not_exist_is_none(fake: FakeEngine, ask: DockerEngine) -> None:
    """HTTP 404 is a response, not a failure."""
    assert probe(ask, {"name": "app"}).container("app") is None


def test_the_prefix_of_an_id_is_not_a_name(fake: FakeEngine, ask: DockerEngine) -> None:
    """The engine accepts an id prefix as a name, which would select another container."""
    fake.containers["other"] = container("other", container_id="abcdef012345" + "0" * 52)
    assert probe(ask, {"name": "abcdef012345"}).container("abcdef012345") is None


def test_a_label_finds_the_one_container_that_has_it(fake: FakeEngine, ask: DockerEngine) -> None:
    """Compose generates names; the label of its service is stable."""
    fake.containers["swarm-app-1"] = container("swarm-app-1", labels={"com.docker.compose.service": "app"})
    fact = probe(ask, {"label": "com.docker.compose.service=app"}).container("app")
    assert fact is not None
    assert fact.name == "swarm-app-1"


def test_a_label_finds_the_running_container_of_several(fake: FakeEngine, ask: DockerEngine) -> None:
    """A container that was replaced is still listed, stopped, beside its successor."""
    fake.containers["old"] = container("old", status="exited", labels={"role": "app"})
    fake.containers["new"] = container("new", labels={"role": "app"})
    fact = probe(ask, {"label": "role=app"}).container("app")
    assert fact is not None
    assert fact.name == "new"


@pytest.mark.parametrize("status", ["running", "exited"])
def test_a_label_of_several_equal_containers_is_ambiguous(fake: FakeEngine, ask: DockerEngine, status: str) -> None:
    """PHM does not guess, since recovery would act on the guess; the error lists the candidates."""
    fake.containers["one"] = container("one", status=status, labels={"role": "app"})
    fake.containers["two"] = container("two", status=status, labels={"role": "app"})
    with pytest.raises(CannotTell, match=r"names 2 containers \(one, two\)"):
        probe(ask, {"label": "role=app"}).container("app")


def test_an_unknown_key_is_an_error(ask: DockerEngine) -> None:
    """Only configured containers can be queried."""
    with pytest.raises(CannotTell, match="no container unknown is configured"):
        probe(ask).container("unknown")


def test_an_incomplete_response_is_still_a_fact() -> None:
    """Engines of other versions and vendors omit fields or set them to null."""
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
    assert fact.memory_limit is fact.created_at is fact.depends_on is None


def test_a_complete_response_is_read_completely() -> None:
    """Health with its last output, static address, devices and mounts are part of the fact."""
    response = container(
        "app",
        networks=["swarm"],
        mounts=[{"Type": "volume", "Name": "v", "Source": "/s", "Destination": "/d", "RW": False}],
    )
    response["Created"] = "2026-11-24T12:00:00.250000001Z"
    response["State"]["Health"] = {
        "Status": "unhealthy",
        "FailingStreak": 4,
        "Log": [{"Output": "old"}, {"Output": "no\n node "}],
    }
    response["NetworkSettings"]["Networks"]["swarm"]["IPAMConfig"] = {
        "IPv4Address": "10.9.0.2",
        "IPv6Address": "fd00::2",
    }
    response["HostConfig"]["Devices"] = [
        {"PathOnHost": "/dev/a", "PathInContainer": "/dev/b", "CgroupPermissions": "r"}
    ]
    response["HostConfig"]["Memory"] = 67108864
    fact = container_fact(response)
    assert (fact.health, fact.health_streak, fact.health_output) == ("unhealthy", 4, "no node")
    assert fact.memory_limit == 67108864
    assert fact.created_at == 1795521600.25
    assert fact.networks[0].fixed_addresses == ("10.9.0.2", "fd00::2")
    assert (fact.mounts[0].name, fact.mounts[0].writable) == ("v", False)
    assert (fact.devices[0].host_path, fact.devices[0].container_path) == ("/dev/a", "/dev/b")


@pytest.mark.parametrize("services", ["", "db:service_healthy:false,cache:service_started:true"])
def test_what_compose_starts_first_is_read_from_its_label(services: str) -> None:
    """Compose 2.26 sets it for each container, also if there is no such service."""
    assert container_fact(container("app", labels={DEPENDS_ON: services})).depends_on == services
    assert container_fact(container("app", labels={})).depends_on is None


def test_failed_probes_since_the_last_that_passed_have_code_and_duration() -> None:
    """Of Go's time stamps, with up to nine decimals and any zone; what cannot be read is unknown."""
    response, zone = container("app"), "+02:00"
    response["State"]["Health"] = {
        "Status": "unhealthy",
        "FailingStreak": 3,
        "Log": [
            {"ExitCode": 1, "Start": f"2026-11-24T23:59:50{zone}", "End": f"2026-11-24T23:59:51{zone}"},
            {"ExitCode": 0, "Start": f"2026-11-24T23:59:53{zone}", "End": f"2026-11-24T23:59:54{zone}"},
            {"ExitCode": -1, "Start": f"2026-11-24T23:59:56{zone}", "End": f"2026-11-25T00:00:26{zone}"},
            {"ExitCode": 1, "Start": f"2026-11-25T00:00:29.999999999{zone}", "End": f"2026-11-25T00:00:30.25{zone}"},
            {"ExitCode": 2, "Start": "yesterday", "End": "2026-13-45T00:00:30Z"},
        ],
    }
    fact = container_fact(response)
    assert (fact.passed_probes_s, fact.probe_ended) == ((1.0,), "2026-13-45T00:00:30Z")
    hung, failed, unknown = fact.failed_probes
    assert (hung.exit_code, hung.took_s) == (-1, 30.0)
    assert (failed.exit_code, failed.took_s) == (1, pytest.approx(0.25, abs=1e-5))
    assert (unknown.exit_code, unknown.took_s) == (2, None)


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
def test_a_healthcheck_has_the_engines_defaults_for_unset_values(
    given: dict[str, Any] | None, read: HealthcheckFact | None
) -> None:
    """Nanoseconds; 0 selects the default, and the test NONE means no healthcheck."""
    answer = {**container("app"), "Config": {"Healthcheck": given}}
    assert container_fact(answer).healthcheck == read


def test_a_response_without_a_state_is_an_error() -> None:
    """A container without a state is a fault of the engine, not a stopped container."""
    with pytest.raises(CannotTell):
        container_fact({"Id": "a"})


def test_a_network_has_an_id_or_does_not_exist(fake: FakeEngine, ask: DockerEngine) -> None:
    """A removed network has an empty id, and a failure raises."""
    fake.networks["swarm"] = {"Id": "n1"}
    docker = probe(ask)
    assert docker.network_id("swarm") == "n1"
    assert docker.network_id("other") == ""
    assert (docker.network_driver("swarm"), docker.network_driver("other")) == ("bridge", "")
    fake.fault = Status(500)
    with pytest.raises(CannotTell):
        docker.network_id("swarm")


def test_the_engine_reports_its_version(ask: DockerEngine) -> None:
    """`engine` proves that the engine responds."""
    assert probe(ask).engine() == "20.10.24"


MINE, OTHER = "a1" * 32, "b2" * 32


def proc(tmp_path: Path, mountinfo: str = "", cgroup: str = "") -> Path:
    (tmp_path / "mountinfo").write_text(mountinfo)
    (tmp_path / "cgroup").write_text(cgroup)
    return tmp_path


def test_the_own_id_is_read_from_the_files_that_the_engine_mounts(tmp_path: Path) -> None:
    """Under cgroup v2 only the source of /etc/hostname has the container id."""
    line = f"269 252 254:0 /var/lib/docker/containers/{MINE}/hostname /etc/hostname rw - ext4 /dev/vda rw\n"
    assert own_ids(proc(tmp_path, line, "0::/\n"))[0] == MINE


def test_the_own_id_is_read_from_the_cgroup(tmp_path: Path) -> None:
    """Under cgroup v1 each path has it."""
    assert MINE in own_ids(proc(tmp_path, cgroup=f"7:blkio:/docker/{MINE}\n"))


def test_a_host_is_not_one_of_its_containers(tmp_path: Path) -> None:
    """The mount table of a host lists all containers: none of them is PHM."""
    line = f"99 24 0:50 / /var/lib/docker/containers/{OTHER}/mounts/shm rw - tmpfs shm rw\n"
    assert OTHER not in own_ids(proc(tmp_path, line, "0::/user.slice\n"))


def test_the_own_container_is_accepted_only_if_the_engine_knows_it(
    fake: FakeEngine, ask: DockerEngine, tmp_path: Path
) -> None:
    """Inside another engine's container (a CI job) the id means nothing to this engine."""
    place = proc(tmp_path, cgroup=f"7:blkio:/docker/{OTHER}/docker/{MINE}\n")
    docker = Docker(ask, [], settings().docker, FakeClock(), proc=place)
    assert docker.own_container() is None
    fake.containers["phm"] = container("phm", container_id=MINE)
    docker.invalidate()
    fact = docker.own_container()
    assert fact is not None
    assert fact.name == "phm"


def test_a_configured_own_container_must_exist(fake: FakeEngine, ask: DockerEngine) -> None:
    """A wrong `docker.container` is an error, not `not in a container`."""
    docker = probe(ask, docker={"container": "phm_1"})
    with pytest.raises(CannotTell, match="phm_1"):
        docker.own_container()
    fake.containers["phm_1"] = container("phm_1")
    docker.invalidate()
    assert docker.own_container() is not None


@pytest.mark.parametrize(
    "named", [{"name": "app"}, {"label": "com.docker.compose.service=app"}], ids=["by name", "by label"]
)
def test_the_application_is_never_the_own_container(
    named: dict[str, str], fake: FakeEngine, ask: DockerEngine, tmp_path: Path
) -> None:
    """With `network_mode: service:app`, PHM has the application's /etc/hostname: it would connect and exempt that one."""
    fake.containers["app"] = container("app", container_id=MINE, labels={"com.docker.compose.service": "app"})
    line = f"269 252 254:0 /var/lib/docker/containers/{MINE}/hostname /etc/hostname rw - ext4 /dev/vda rw\n"
    chosen = settings(containers=[named])
    docker = Docker(ask, chosen.containers, chosen.docker, FakeClock(), proc=proc(tmp_path, line, "0::/\n"))
    with pytest.raises(CannotTell, match=r"set docker\.container"):
        docker.own_container()
    fake.containers["app"]["Config"]["Entrypoint"] = ["ros-entrypoint", "phm"]  # PHM itself is configured
    docker.invalidate()
    assert docker.own_container() is not None


def test_with_the_network_of_another_container_phm_is_on_the_same_networks(fake: FakeEngine, ask: DockerEngine) -> None:
    """The engine lists no networks for PHM's own container then."""
    fake.containers["app"] = container("app", container_id=OTHER, networks=["swarm"])
    fake.containers["phm"] = container("phm", container_id=MINE)
    fake.containers["phm"]["HostConfig"]["NetworkMode"] = f"container:{OTHER}"
    fact = probe(ask, docker={"container": "phm"}).own_container()
    assert fact is not None
    assert [attached.name for attached in fact.networks] == ["swarm"]


@pytest.mark.parametrize("address", ["127.0.0.1", "::1"])
def test_the_local_machine_responds(ask: DockerEngine, address: str) -> None:
    """A closed port that refuses proves that the address responds."""
    assert probe(ask).reachable(address)


def test_an_address_that_no_longer_responds_is_silent() -> None:
    """ARP keeps a departed neighbour for up to a minute; it counts only for addresses that never responded before."""
    there = True
    reach = Pinger(ping=lambda _, limit_s: there, known=lambda _: True)
    assert reach.answers("10.0.0.2", "first run")
    there = False
    assert not reach.answers("10.0.0.2", "first run")
    assert reach.answers("10.0.0.2", "second run"), "a firewall drops our packets"
    assert reach.answers("10.0.0.3")


def test_an_address_stays_silent_while_another_check_asks_the_engine(
    fake: FakeEngine, ask: DockerEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Which run has the address is known meanwhile: ARP would count else, and the address would respond now and then."""
    fake.containers["app"] = container("app")
    fake.containers["app"]["NetworkSettings"]["Networks"] = {"swarm": {"NetworkID": "id-1", "IPAddress": "10.0.0.2"}}
    docker, there, meanwhile = probe(ask, {"name": "app"}), True, []
    docker._pinger = Pinger(ping=lambda _, limit_s: there, known=lambda _: True)
    assert docker.container("app") is not None and docker.reachable("10.0.0.2")
    there, inspect = False, ask.inspect

    def inspect_meanwhile(*words: Any, **more: Any) -> Any:
        meanwhile.append(docker.reachable("10.0.0.2"))
        return inspect(*words, **more)

    monkeypatch.setattr(ask, "inspect", inspect_meanwhile)
    docker.invalidate()
    assert docker.container("app") is not None
    assert meanwhile == [False]


def test_a_name_instead_of_an_address_is_an_error(ask: DockerEngine) -> None:
    """A name is not resolved: that would need its own deadline."""
    with pytest.raises(CannotTell, match="not an IP address"):
        probe(ask).reachable("ros_app")


def test_others_are_the_running_containers_that_are_not_configured(fake: FakeEngine, ask: DockerEngine) -> None:
    """Configured ones are known by name or label, PHM's own by its id; stopped ones do not count."""
    for name in ("app", "db", "me", "zed", "alone"):
        fake.containers[name] = container(name)
    fake.containers["db"]["Config"]["Labels"] = {"role": "db"}
    fake.containers["alone"]["State"]["Status"] = "exited"
    chosen = settings(containers=[{"name": "app"}, {"label": "role=db"}], docker={"container": "me"})
    made = Docker(ask, chosen.containers, chosen.docker, FakeClock())
    assert [other.name for other in made.others()] == ["zed"]


def test_the_attachment_of_a_disconnected_container_is_known_after_a_reload(
    fake: FakeEngine, ask: DockerEngine
) -> None:
    """Its aliases and its fixed address are restored when it is connected again; the engine has forgotten them. PHM's own, too."""
    me = {"docker": {"container": "phm"}}
    fake.containers |= {name: container(name, networks=["swarm"]) for name in ("app", "phm")}
    before = AttachmentCache(probe(ask, {"name": "app"}, **me))
    before.container("app")
    before.own_container()
    fake.containers |= {name: container(name) for name in ("app", "phm")}
    after = AttachmentCache(probe(ask, {"name": "app"}, **me))
    after.resume(before, {"app"})
    after.container("app")
    after.own_container()
    mine = after.own_remembered("swarm")
    assert mine is not None and mine.aliases == ("phm",)
    known = after.remembered("app", "swarm")
    assert known is not None and known == before.remembered("app", "swarm")
    removed = AttachmentCache(probe(ask))
    removed.resume(before, set())
    assert removed.remembered("app", "swarm") is None
