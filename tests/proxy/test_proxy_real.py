"""A real HAProxy in front of the real engine: PHM's requests pass, and anything else from a compromised PHM gets 403."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from typing import Any

import pytest

from phm.probes.docker_event import FILTERS
from phm.probes.docker_processes import FORMS
from phm.testing import settings
from phm.transport import docker_bodies
from phm.transport.docker import DockerEngine, EngineMissing, EngineRefused
from sitl.faults.base import freeze
from tests.fakes.until import until
from tests.proxy.haproxy import LIMIT_S, Proxies, Proxy

pytestmark = pytest.mark.engine

RUN = ["touch", "/tmp/ran"]
FILE = "/etc/hostname"
WAIT = "trap 'exit 0' TERM; while :; do sleep 0.1; done"
API = "/v1.41"
UNKNOWN = "0123456789abcdef" * 4
PRIVILEGED = b'{"Binds": ["/:/host"], "Privileged": true}'


@dataclass
class Place:
    """A configured container and network, an unknown one of each, and a proxy in front of their engine."""

    proxy: Proxy
    client: DockerEngine
    app: Any
    other: Any
    me: str
    net: Any
    foreign_net: Any
    ps: str = docker_bodies.query({"ps_args": FORMS[0]})

    def fill(self, text: str) -> str:
        """Replace names in braces by their values."""
        words = {
            "app": self.app.name, "app_id": self.app.id, "app_short": self.app.id[:12], "other": self.other.name,
            "other_id": self.other.id, "other_short": self.other.id[:12], "me": self.me, "net": self.net.name,
            "net_id": self.net.id, "foreign": self.foreign_net.name, "foreign_id": self.foreign_net.id, "ps": self.ps,
        }  # fmt: skip
        return re.sub(r"<(\w+)>", lambda match: words[match[1]], text)

    def learn(self) -> None:
        self.client.inspect(self.app.name)
        self.client.inspect_network(self.net.name)


@pytest.fixture
def place(real: Any, proxies: Proxies) -> Place:
    net, foreign = real.network(), real.network()
    app, other = real.container(WAIT, network=net.name), real.container(WAIT)
    docker = proxies.docker()
    made = settings(
        docker=docker,
        containers=[
            {
                "name": app.name, "alias": "app", "recover": True, "networks": [net.name],
                "files": [{"path": FILE, "sha256": "0" * 64, "restore": "/golden"}],
            }
        ],
        ros={"nodes": [{"name": "/one", "container": "app", "relaunch": RUN}]},
    )  # fmt: skip
    proxy = proxies.before(made)
    client = DockerEngine(docker["socket"], timeout_s=LIMIT_S)
    return Place(proxy, client, app, other, docker["container"], net, foreign)


def test_requests_that_phm_needs_pass(place: Place) -> None:
    """Each request of PHM's client for a container, its network, its program and its file, by name and by id."""
    client, app, net = place.client, place.app, place.net
    assert client.version()["Version"]
    place.learn()
    for ref in (app.name, app.id):
        assert client.inspect(ref)["Id"] == app.id
        for form in (*FORMS, "-ef"):
            assert client.top(ref, form)["Processes"]
        assert client.stat_path(ref, FILE)["name"] == "hostname"
        assert client.copy_file(ref, FILE, lambda piece: None, limit=1 << 20)
        client.restart(ref, 3.0)
        client.start(ref)
        freeze(app)
        client.unpause(ref)
    for network in (net.name, net.id):
        client.disconnect(network, app.name, force=True)
        client.connect(network, app.name, aliases=["one", "two"])
        client.connect(network, place.me)
        client.disconnect(network, place.me, force=True)
    client.exec_detached(app.id, RUN)
    until(lambda: app.exec_run(["test", "-e", "/tmp/ran"])[0] == 0, "the program to run")
    client.put_file(app.id, "/etc/new", b"new" * 10_000, 0o644)
    # By the exit code: the engine may lose the output of a program that ends before it is attached.
    assert app.exec_run(["sh", "-c", "test $(wc -c < /etc/new) = 30000"])[0] == 0
    with client.events("", FILTERS) as stream:
        client.restart(app.id, 1.0)
        assert any(event["Actor"]["ID"] == app.id for event in stream)
    assert place.proxy.said.read_text("utf-8").count("containers") == 0


FORBIDDEN = {
    "attach": ("POST", f"{API}/containers/<app>/attach?stream=1&stdin=1&stdout=1", b""),
    "attach by websocket": ("GET", f"{API}/containers/<app>/attach/ws?stream=1", b""),
    "export": ("GET", f"{API}/containers/<app>/export", b""),
    "logs": ("GET", f"{API}/containers/<app>/logs?stdout=1", b""),
    "changes": ("GET", f"{API}/containers/<app>/changes", b""),
    "stats": ("GET", f"{API}/containers/<app>/stats?stream=0", b""),
    "create": ("POST", f"{API}/containers/create", b'{"Image": "phm-base:dev", "HostConfig": {"Binds": ["/:/host"]}}'),
    "create, named": ("POST", f"{API}/containers/create?name=<app>", b'{"Image": "phm-base:dev"}'),
    "commit": ("POST", f"{API}/commit?container=<app>", b"{}"),
    "list": ("GET", f"{API}/containers/json?all=1", b""),
    "info": ("GET", f"{API}/info", b""),
    "images": ("GET", f"{API}/images/json", b""),
    "pull": ("POST", f"{API}/images/create?fromImage=busybox", b""),
    "build": ("POST", f"{API}/build", b""),
    "volumes": ("GET", f"{API}/volumes", b""),
    "make a network": ("POST", f"{API}/networks/create", b'{"Name": "evil"}'),
    "list networks": ("GET", f"{API}/networks", b""),
    "remove a network": ("DELETE", f"{API}/networks/<net>", b""),
    "swarm": ("GET", f"{API}/swarm", b""),
    "plugins": ("GET", f"{API}/plugins", b""),
    "session": ("POST", "/session", b""),
    "grpc": ("POST", "/grpc", b""),
    "unversioned": ("GET", "/containers/<app>/json", b""),
    "remove": ("DELETE", f"{API}/containers/<app>?force=1", b""),
    "kill": ("POST", f"{API}/containers/<app>/kill", b""),
    "stop": ("POST", f"{API}/containers/<app>/stop?t=0", b""),
    "pause": ("POST", f"{API}/containers/<app>/pause", b""),
    "rename": ("POST", f"{API}/containers/<app>/rename?name=other", b""),
    "update": ("POST", f"{API}/containers/<app>/update", b'{"Memory": 4194304}'),
    "resize": ("POST", f"{API}/containers/<app>/resize?h=1&w=1", b""),
    "start with a body": ("POST", f"{API}/containers/<app>/start", PRIVILEGED),
    "start of old with a body": ("POST", "/v1.18/containers/<app>/start", PRIVILEGED),
    "start of old": ("POST", "/v1.23/containers/<app>/start", b""),
    "restart, more words": ("POST", f"{API}/containers/<app>/restart?t=1&signal=KILL", b""),
    "another container": ("GET", f"{API}/containers/<other>/json", b""),
    "another container by id": ("GET", f"{API}/containers/<other_id>/json", b""),
    "a short id": ("GET", f"{API}/containers/<app_short>/json", b""),
    "restart another": ("POST", f"{API}/containers/<other>/restart?t=1", b""),
    "restart another by id": ("POST", f"{API}/containers/<other_id>/restart?t=1", b""),
    "restart PHM": ("POST", f"{API}/containers/<me>/restart?t=1", b""),
    "an unknown id": ("POST", f"{API}/containers/{UNKNOWN}/restart?t=1", b""),
    "top of another": ("GET", f"{API}/containers/<other>/top<ps>", b""),
    "top with the environment": ("GET", f"{API}/containers/<app>/top?ps_args=eww", b""),
    "exec of another program": ("POST", f"{API}/containers/<app>/exec", docker_bodies.exec_(["sh"]).encode()),
    "exec in another": ("POST", f"{API}/containers/<other>/exec", docker_bodies.exec_(RUN).encode()),
    "exec as root": ("POST", f"{API}/containers/<app>/exec", docker_bodies.exec_(RUN, "root").encode()),
    "exec, privileged": (
        "POST", f"{API}/containers/<app>/exec",
        docker_bodies.exec_(RUN).encode()[:-1] + b', "Privileged": true}',
    ),
    "exec, twice named": (
        "POST", f"{API}/containers/<app>/exec",
        docker_bodies.exec_(RUN).encode()[:-1] + b', "cmd": ["sh"]}',
    ),
    "exec, two bodies": (
        "POST", f"{API}/containers/<app>/exec", docker_bodies.exec_(["sh"]).encode() + docker_bodies.exec_(RUN).encode()
    ),
    "exec, more after it": (
        "POST", f"{API}/containers/<app>/exec", docker_bodies.exec_(RUN).encode() + b'{"Cmd": ["sh"]}'
    ),
    "exec, longer than is read": (
        "POST", f"{API}/containers/<app>/exec", docker_bodies.exec_(RUN).encode() + b" " * 9_000 + b'{"Cmd": ["sh"]}'
    ),
    "start of an unknown program": ("POST", f"{API}/exec/{UNKNOWN}/start", docker_bodies.START_EXEC.encode()),
    "look at a program": ("GET", f"{API}/exec/{UNKNOWN}/json", b""),
    "another file": ("HEAD", f"{API}/containers/<app>/archive?path=%2Fetc%2Fshadow", b""),
    "read another file": ("GET", f"{API}/containers/<app>/archive?path=%2Fetc%2Fshadow", b""),
    "read a folder": ("GET", f"{API}/containers/<app>/archive?path=%2Fetc", b""),
    "read a file, twice named": (
        "GET", f"{API}/containers/<app>/archive?path=%2Fetc%2Fhostname&path=%2Fetc%2Fshadow", b""
    ),
    "write elsewhere": ("PUT", f"{API}/containers/<app>/archive?path=%2F&noOverwriteDirNonDir=true", b""),
    "write into another": ("PUT", f"{API}/containers/<other>/archive?path=%2Fetc&noOverwriteDirNonDir=true", b""),
    "file of another": ("HEAD", f"{API}/containers/<other>/archive?path=%2Fetc%2Fhostname", b""),
    "another network": ("GET", f"{API}/networks/<foreign>", b""),
    "another network by id": ("GET", f"{API}/networks/<foreign_id>", b""),
    "connect another": ("POST", f"{API}/networks/<net>/connect", b'{"Container": "<other>", "EndpointConfig": {}}'),
    "connect another by id": (
        "POST", f"{API}/networks/<net_id>/connect", b'{"Container": "<other_id>", "EndpointConfig": {}}'
    ),
    "connect elsewhere": ("POST", f"{API}/networks/<foreign>/connect", b'{"Container": "<app>", "EndpointConfig": {}}'),
    "connect PHM to the host": ("POST", f"{API}/networks/host/connect", b'{"Container": "<me>", "EndpointConfig": {}}'),
    "connect with options": (
        "POST", f"{API}/networks/<net>/connect",
        b'{"Container": "<app>", "EndpointConfig": {"DriverOpts": {"a": "b"}}}',
    ),
    "connect, twice named": (
        "POST", f"{API}/networks/<net>/connect",
        b'{"Container": "<app>", "container": "<other>", "EndpointConfig": {}}',
    ),
    "disconnect another": ("POST", f"{API}/networks/<net>/disconnect", b'{"Container": "<other>", "Force": true}'),
    "prune": ("POST", f"{API}/networks/prune", b""),
    "all events": ("GET", f"{API}/events", b""),
    "events of images": ("GET", f"{API}/events?filters=%7B%22type%22%3A+%5B%22image%22%5D%7D", b""),
    "two slashes": ("GET", f"/{API}/containers/<other>/json", b""),
    "dots": ("GET", f"{API}/containers/<app>/../<other>/json", b""),
    "encoded dots": ("GET", f"{API}/containers/<app>%2f..%2f<other>/json", b""),
    "encoded name": ("GET", f"{API}/containers/%3Cother%3E/json", b""),
    "a whole address": ("GET", f"http://engine{API}/containers/<other>/json", b""),
    "another host": ("GET", f"http://{API}/containers/<app>/json{API}/containers/<other>/json", b""),
    "a question": ("GET", f"{API}/containers/<other>/json?x=/containers/<app>/json", b""),
    "parameters of a path": ("GET", f"{API}/containers/<app>;<other>/json", b""),
    "another method": ("OPTIONS", f"{API}/containers/<app>/json", b""),
    "a separate method": ("get", f"{API}/containers/<app>/json", b""),
}  # fmt: skip


def test_each_forbidden_request_gets_403_and_changes_nothing(place: Place) -> None:
    """With learned ids of the configured objects, as after some minutes of operation."""
    place.learn()
    before = {one.id: place.app.client.api.inspect_container(one.id) for one in (place.app, place.other)}
    answers = {}
    for name, (method, path, body) in FORBIDDEN.items():
        answers[name] = place.proxy.ask(method, place.fill(path), place.fill(body.decode()).encode())[0]
    assert {name: status for name, status in answers.items() if status != 403} == {}
    for one in (place.app, place.other):
        now = one.client.api.inspect_container(one.id)
        for part in ("State", "Name", "HostConfig"):
            assert now[part] == before[one.id][part]
        assert now["NetworkSettings"]["Networks"].keys() == before[one.id]["NetworkSettings"]["Networks"].keys()
    assert place.app.exec_run(["test", "-e", "/tmp/ran"])[0] == 1


def test_requests_in_other_forms_do_not_pass(place: Place) -> None:
    """In fragments, with a false length, with a NUL after an allowed path, or with a URL fragment, nothing reaches the engine."""
    path, body = f"{API}/containers/{place.app.name}/exec", docker_bodies.exec_(["sh"]).encode()
    pieces = f"{len(body):x}\r\n".encode() + body + b"\r\n0\r\n\r\n"
    assert place.proxy.ask("POST", path, pieces, more={"Transfer-Encoding": "chunked"})[0] == 403
    allowed = docker_bodies.exec_(RUN).encode()
    assert place.proxy.ask("POST", path, allowed + b"\0" + body)[0] in (400, 403)
    assert place.proxy.ask("POST", path, allowed, length=len(allowed) + 5)[0] in (403, 408)
    both = {"Content-Length": str(len(allowed)), "Transfer-Encoding": "chunked"}
    assert place.proxy.ask("POST", path, pieces, more=both)[0] in (400, 403)
    fragment = f"{API}/containers/{place.other.name}/json#/containers/{place.app.name}/json"
    assert place.proxy.ask("GET", fragment)[0] in (400, 403)
    assert not place.app.client.api.inspect_container(place.app.id)["ExecIDs"]


UPGRADES: list[dict[str, str]] = [
    {"Connection": "Upgrade", "Upgrade": "tcp"},
    {"Connection": "close, upgrade", "Upgrade": "h2c"},
    {"Upgrade": "websocket"},
    {"Connection": "UPGRADE"},
]


@pytest.mark.parametrize("headers", UPGRADES, ids=str)
def test_an_allowed_request_does_not_pass_with_an_upgrade(place: Place, headers: dict[str, str]) -> None:
    """The engine would turn the connection into a stream, which the proxy does not read; PHM needs none."""
    place.learn()
    assert place.proxy.ask("GET", f"{API}/containers/{place.app.name}/json", more=headers)[0] == 403
    made = place.proxy.ask("POST", f"{API}/containers/{place.app.id}/exec", docker_bodies.exec_(RUN).encode())[1]
    start, body = f"{API}/exec/{json.loads(made)['Id']}/start", docker_bodies.START_EXEC.encode()
    assert place.proxy.ask("POST", start, body, more=headers)[0] == 403
    assert place.app.exec_run(["test", "-e", "/tmp/ran"])[0] == 1
    until(lambda: "403 POST" in place.proxy.said.read_text("utf-8"), "the proxy's line")
    assert place.proxy.ask("POST", start, body)[0] == 200


def test_an_exec_of_another_client_is_not_started(place: Place) -> None:
    """Only one that was created through this proxy; and never with attached streams."""
    place.learn()
    theirs = place.app.client.api.exec_create(place.app.id, ["touch", "/tmp/ran"])["Id"]
    assert place.proxy.ask("POST", f"{API}/exec/{theirs}/start", docker_bodies.START_EXEC.encode())[0] == 403
    status, answer = place.proxy.ask("POST", f"{API}/containers/{place.app.id}/exec", docker_bodies.exec_(RUN).encode())
    assert status == 201
    mine = json.loads(answer)["Id"]
    assert place.proxy.ask("POST", f"{API}/exec/{mine}/start", b'{"Detach": false, "Tty": true}')[0] == 403
    assert place.proxy.ask("POST", f"{API}/exec/{mine}/start", docker_bodies.START_EXEC.encode())[0] == 200


def test_an_id_is_accepted_from_one_response_about_its_name_to_the_next(place: Place, real: Any) -> None:
    """Before it, the id is unknown; the id of a container that was replaced, or whose name is gone, is unknown again."""
    with pytest.raises(EngineRefused):
        place.client.inspect(place.app.id)
    place.learn()
    assert place.client.inspect(place.app.id)["Id"] == place.app.id
    place.app.rename(real.name())
    with pytest.raises(EngineMissing):
        place.client.inspect(place.fill("<app>"))
    with pytest.raises(EngineRefused):
        place.client.restart(place.app.id)
    former = place.app.name
    successor = real.container(name=former)
    assert place.client.inspect(former)["Id"] == successor.id
    with pytest.raises(EngineRefused):
        place.client.restart(place.app.id)


def test_an_id_is_learned_from_a_long_response(real: Any, proxies: Proxies) -> None:
    """Longer than the buffer of the proxy because of its labels."""
    app = real.container(labels={f"long-{number}": "x" * 1000 for number in range(100)})
    client, _ = proxies.behind(containers=[{"name": app.name}])
    client.inspect(app.name)
    assert client.inspect(app.id)["Id"] == app.id


def test_a_dot_in_a_name_is_literal(real: Any, proxies: Proxies) -> None:
    """Of a container whose name differs from the configured one at a special character of patterns."""
    stem = real.name()
    net = real.network()
    app, other = real.container(name=f"{stem}.a"), real.container(name=f"{stem}xa")
    client, _ = proxies.behind(containers=[{"name": app.name, "recover": True, "networks": [net.name]}])
    client.connect(net.name, app.name)
    with pytest.raises(EngineRefused):
        client.inspect(other.name)
    with pytest.raises(EngineRefused):
        client.connect(net.name, other.name)


HOSTILE = [
    "it's", '"', "\\", "\\\\'", "$HOME", "${HOME}", "`id`", "a b", "#", "' allow if TRUE #", "}", "] }", "\n", "\t", "\0",
    "é", "\u2028", "%", "*", ".*", "(?:", "^$", ",", ";", "\x7f", "x" * 200,
]  # fmt: skip


def test_hostile_names_have_no_special_meaning(real: Any, proxies: Proxies) -> None:
    """Words of a command and characters of a path that are special in HAProxy, in its quotes or its patterns."""
    app = real.container()
    nodes = [
        {"name": f"/n{number}", "container": "app", "relaunch": ["true", word]} for number, word in enumerate(HOSTILE)
    ]
    files = [{"path": f"/{word.replace(chr(0), '')}/f"} for word in HOSTILE]
    client, made = proxies.behind(
        containers=[{"name": app.name, "alias": "app", "recover": True, "files": files}], ros={"nodes": nodes}
    )
    for node in made.ros.nodes:
        if "\0" not in node.relaunch[1]:
            client.exec_detached(app.name, node.relaunch)
        for argv in (["true", node.relaunch[1] + "x"], ["true"], ["false", node.relaunch[1]]):
            with pytest.raises(EngineRefused):
                client.exec_detached(app.name, argv)
    for file in made.containers[0].files:
        with pytest.raises(EngineMissing):
            client.stat_path(app.name, file.path)
        with pytest.raises(EngineRefused):
            client.stat_path(app.name, file.path + "x")


def test_without_recovery_no_action_is_allowed(real: Any, proxies: Proxies) -> None:
    """`recovery.mode: off`, or a container that has not opted in: PHM may read, and connect itself to networks."""
    net, app = real.network(), real.container()
    entry = {"name": app.name, "networks": [net.name]}
    for more in ({"containers": [{**entry, "recover": True}], "recovery": {"mode": "off"}}, {"containers": [entry]}):
        client, made = proxies.behind(**more)
        assert client.inspect(app.name)["Id"] == app.id
        for act in (client.start, client.restart, client.unpause):
            with pytest.raises(EngineRefused):
                act(app.name)
        with pytest.raises(EngineRefused):
            client.connect(net.name, app.name)
        client.connect(net.name, str(made.docker.container))
        client.disconnect(net.name, str(made.docker.container))


def test_containers_are_listed_only_where_unknown_ones_are_requested(real: Any, proxies: Proxies) -> None:
    """Only the running ones, without any parameter: the list of all containers has a parameter."""
    app, other = real.container(), real.container()
    entry: dict[str, Any] = {"containers": [{"name": app.name}]}
    client, _ = proxies.behind(**entry)
    with pytest.raises(EngineRefused):
        client.running()
    client, _ = proxies.behind(**entry, docker={"unknown_containers": {"level": "warn"}})
    assert {f"/{app.name}", f"/{other.name}"} <= {name for one in client.running() for name in one["Names"]}
    with pytest.raises(EngineRefused):
        client.list()


def test_a_refusal_is_logged_and_reported_to_phm(place: Place) -> None:
    """The operator finds the request in the proxy's log, and PHM's message says where to look."""
    with pytest.raises(EngineRefused, match="phm proxy-rules"):
        place.client.inspect(place.other.name)
    line = re.compile(rf"403 GET /v[\d.]+/containers/{place.other.name}/json")  # in the version of the engine
    until(
        lambda: line.search(place.proxy.said.read_text("utf-8")), "the proxy's line"
    )  # it is written after the response
