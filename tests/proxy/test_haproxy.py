"""`phm proxy-rules`: its output, and the configurations that it rejects."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from hypothesis import given, strategies as st

from phm.cli import group
from phm.proxy.calls import calls, exact
from phm.proxy.haproxy import NoRules, quoted, rules
from phm.testing import settings
from phm.transport import docker_bodies
from phm.transport.docker import DockerEngine

ENGINE = "/var/run/docker.sock"
SOCKET = "unix:///run/phm-engine/docker.sock"
DOCKER = {"socket": SOCKET, "container": "phm"}
NEEDED = {
    "call",
    "calling",
    "close",
    "version",
    "running",
    "inspect",
    "inspect_network",
    "stats",
    "top",
    "stat_path",
    "read_file",
    "copy_file",
    "events",
    "start",
    "restart",
    "unpause",
    "disconnect",
    "connect",
    "exec_create",
    "exec_detached",
    "exec_exit_code",
    "exec_read",
    "logs",
    "put_file",
    "set_cpu_shares",
}
REFUSED = {"list", "stop", "pause", "kill", "fetch_file", "create_from_image", "remove", "copy_with_stat"}
"""Used by tests and the simulation, for labels, or by `restore: image`."""


def made(**yaml_like: Any) -> str:
    return rules(settings(**{"docker": DOCKER, **yaml_like}), ENGINE)


def refused(**yaml_like: Any) -> str:
    with pytest.raises(NoRules) as caught:
        made(**yaml_like)
    return str(caught.value)


def invoke(folder: Path, text: str, *more: str) -> Result:
    file = folder / "phm.yaml"
    file.write_text(text, "utf-8")
    return CliRunner().invoke(group, ["proxy-rules", "-c", str(file), *more], prog_name="phm")


def test_each_method_of_the_client_is_covered_by_the_rules() -> None:
    """A new method of the client is allowed by a rule, or is listed among those that the proxy refuses."""
    public = {name for name in dir(DockerEngine) if not name.startswith("_") and callable(getattr(DockerEngine, name))}
    assert public == NEEDED | REFUSED


def test_configuration_that_rules_cannot_match_exactly_is_rejected_with_advice() -> None:
    """Labels, names that could be the prefix of an id, PHM's own container without a name, the engine's own socket."""
    assert "give its `name`" in refused(containers=[{"label": "com.app=one"}])
    assert "cafe could also be the beginning of an id" in refused(containers=[{"name": "cafe"}])
    assert "networks: 0 could" in refused(containers=[{"name": "app", "networks": ["0"]}])
    assert "docker.container: needed" in refused(docker={"socket": SOCKET})
    assert "docker.container: phm" not in refused(docker={"socket": SOCKET, "container": "abba"})
    for socket in (f"unix://{ENGINE}", "tcp://proxy:2375"):
        assert "the proxy's own unix socket" in refused(docker={"socket": socket, "container": "phm"})
    for socket in ("unix:///tmp/a b", "unix:///tmp/a,/tmp/b"):
        assert "must be a path of letters" in refused(docker={"socket": socket, "container": "phm"})


def test_the_rules_allow_only_what_the_configuration_needs() -> None:
    """No exec without `relaunch`, no archive without files, no `top` without nodes, no POST without `recover`."""
    plain = made(containers=[{"name": "app"}])
    assert not re.search(r"/exec|archive|/top|POST|PUT", "".join(re.findall(r"http-request allow.*", plain)))
    assert "POST" in made(containers=[{"name": "app", "recover": True}])
    assert "/top" in made(containers=[{"name": "app"}], ros={"nodes": [{"name": "/one"}]})
    looked_at = made(containers=[{"name": "app", "recover": True, "files": [{"path": "/a"}]}])
    assert "HEAD" in looked_at
    assert "PUT" not in looked_at
    restored = made(containers=[{"name": "app", "recover": True, "files": [{"path": "/a/b", "restore": "/golden"}]}])
    assert "PUT" in restored


def test_each_kind_of_call_is_in_the_documented_table() -> None:
    """docs/reference/security.md lists each method with the last word of its path, and how a program is started."""
    page = (Path(__file__).parents[2] / "docs" / "reference" / "security.md").read_text("utf-8")
    table = page.split("The rules allow:", 1)[1].split("*Recovery may act*", 1)[0]
    documented, method, verb = set(), "", ""
    for row in re.findall(r"^\| (`[^|]*) \|", table, re.MULTILINE):
        for token in re.findall(r"`([^`]+)`", row):
            found = re.fullmatch(r"([A-Z]*) ?(?:/?(?:[^/?]*/)*([^/?]*).*)?", token)
            assert found is not None
            method, verb = found[1] or method, found[2] or verb
            documented.add((method, verb))
    custom = [
        {"name": "fuel", "type": "command", "command": ["fuel"], "container": "app"},
        {"name": "log", "type": "log", "container": "app", "patterns": [{"pattern": "x"}]},
        {"name": "one", "type": "process", "process": ["x"], "container": "app"},
    ]
    restored = {"path": "/ws/a", "restore": "/golden/a", "sha256": "0" * 64}
    app = {"name": "app", "recover": True, "networks": ["net"], "files": [restored]}
    nodes = [{"name": "/n", "container": "app", "relaunch": ["run"]}]
    everything = settings(
        docker={**DOCKER, "unknown_containers": {"level": "warn"}},
        containers=[app, {"name": "video"}],
        custom=custom,
        ros={"nodes": nodes},
        recovery={"relieve": ["video"]},
    )
    made = calls(everything)
    used = {
        (call.method, "".join(re.findall(r"[a-z]+", re.split(r"[?(\\]", call.path)[0])[-1:]) or "N") for call in made
    }
    assert used - documented == set()
    assert len(used) > 12
    assert all(call.starts in table for call in made)


@pytest.mark.parametrize("fixed", [(), ("10.9.0.7",), ("fd00::7",), ("10.9.0.7", "fd00::7")])
@pytest.mark.parametrize("names", [(), ("one",), ("one", "two")])
def test_a_connection_with_aliases_and_fixed_addresses_is_allowed(
    names: tuple[str, ...], fixed: tuple[str, ...]
) -> None:
    """As `reconnect` and `join_network` ask for it, and nothing that is added to it."""
    entry = {"name": "app", "recover": True, "networks": ["swarm"]}
    bodies = [str(call.body) for call in calls(settings(docker=DOCKER, containers=[entry])) if call.path == "/connect"]
    assert len(bodies) == 2
    for name in ("phm", "app"):
        text = docker_bodies.connect(name, names, fixed)
        assert [bool(re.fullmatch(body, text)) for body in bodies].count(True) == 1
        more = text.removesuffix("}}") + ', "Links": []}}'
        assert not any(re.fullmatch(body, more) for body in bodies)


def test_the_running_containers_are_listed_only_where_requested() -> None:
    """The list shows all containers of the computer, so the configuration must ask for unknown ones."""
    entry = {"containers": [{"name": "app"}]}
    assert "/containers/json" not in made(**entry)
    for level in ("warn", "error"):
        text = made(**entry, docker={**DOCKER, "unknown_containers": {"level": level}})
        (rule,) = re.findall(r"http-request allow.*/containers/json.*", text)
        assert "method GET" in rule and "empty" in rule


def test_the_rules_have_both_sockets() -> None:
    """PHM connects to `docker.socket`; the engine is where the proxy sees it."""
    text = rules(settings(docker=DOCKER), "/run/other.sock")
    assert "bind unix@/run/phm-engine/docker.sock mode 660" in text
    assert "server engine unix@/run/other.sock" in text


@given(st.text())
def test_a_quoted_word_ends_only_at_its_own_end(text: str) -> None:
    """In strong quotes, each quote of the text is closed, escaped and opened again."""
    word = quoted(text)
    assert word[0] == word[-1] == "'"
    assert word[1:-1].replace(r"'\''", "\0quote\0").count("'") == 0
    assert word[1:-1].replace(r"'\''", "'") == text or r"'\''" in text


@given(st.text(), st.text())
def test_an_exact_pattern_matches_only_its_text(text: str, other: str) -> None:
    """Every special character of patterns is escaped."""
    pattern = re.compile(exact(text))
    assert pattern.fullmatch(text)
    assert not pattern.fullmatch(other) or other == text


def test_the_verb_writes_a_file_and_warns_of_actions_that_will_be_refused(tmp_path: Path) -> None:
    """`restore: image` needs to create a container, which the proxy never allows."""
    text = f"""
docker: {{socket: '{SOCKET}', container: phm}}
containers:
  - {{name: app, recover: true, files: [{{path: /a, restore: image}}]}}
"""
    file = tmp_path / "haproxy.cfg"
    result = invoke(tmp_path, text, "--output", str(file))
    assert result.exit_code == 0
    assert "restore of /a from the image will be refused" in result.output
    assert file.read_text("utf-8").startswith("# Made by `phm proxy-rules`")
    assert "backend engine" in invoke(tmp_path, text).output


def test_the_verb_ends_with_78_and_every_problem(tmp_path: Path) -> None:
    """As for any invalid configuration; nothing is written."""
    result = invoke(tmp_path, "containers: [{label: one}]\n", "--output", str(tmp_path / "haproxy.cfg"))
    assert result.exit_code == 78
    assert len(result.output.splitlines()) == 3
    assert not (tmp_path / "haproxy.cfg").exists()


def test_the_verb_reports_that_it_cannot_write(tmp_path: Path) -> None:
    """The path and the reason, and no traceback."""
    result = invoke(tmp_path, f"docker: {{socket: '{SOCKET}', container: phm}}\n", "--output", "/nowhere/haproxy.cfg")
    assert result.exit_code == 1
    assert "/nowhere/haproxy.cfg cannot be written: No such file or directory" in result.output
