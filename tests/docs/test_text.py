"""Text blocks of the documents: diagrams, files of one or two lines, and a session of MAVProxy."""

from __future__ import annotations

import re
from pathlib import Path
from pkgutil import resolve_name

import pytest

from phm import testing
from phm.gcs.web.options import read_tokens
from phm.transport.dialect import mavlink
from phm.wire.command import CommandResult
from sitl.swarm import config
from sitl.swarm.options import Options
from tests.commands.test_mavlink_commands import ALL, Scene, long
from tests.docs.blocks import Block, containing
from tests.docs.examples import ROOT
from tests.docs.test_commands import of_phm
from tests.fakes.path_world import PathWorld
from tests.recovery.test_restart_path import PATH

CODE_LIKE = re.compile(r"(?<![\w-])(--\w+|\w+(?:[._/]\w+)+|\w+_\w+|[A-Z][a-z]+[A-Z]\w*)")
FILES = frozenset({"phm.yaml", "phm.jsonl"})

FLOW = {
    "config": "phm.config",
    "daemon": "phm.runtime.daemon",
    "scheduler": "phm.checking.scheduler",
    "check": "phm.api:Check",
    "probes": "phm.probes",
    "world": "phm.api:World",
    "Result": "phm.api:Result",
    "pipeline": "phm.checking.pipeline",
    "tracker": "phm.tracker",
    "Transition": "phm.core.model:Transition",
    "Fault": "phm.core.model:Fault",
    "bus": "phm.core.bus",
    "log": "phm.reporters.log",
    "status": "phm.reporters.status",
    "MAVLink": "phm.reporters.mavlink",
    "ROS": "phm.reporters.diagnostics",
    "Zenoh": "phm.reporters.fleet",
    "alerts": "phm.reporters.notify",
    "metrics": "phm.reporters.metrics",
    "policy": "phm.recovery.policy",
    "executor": "phm.recovery.executor",
    "action": "phm.recovery.actions",
}
GROUND = {
    "gcs.station": "phm.gcs.station",
    "gcs.fleet_state": "phm.gcs.fleet_state",
    "events": "phm.gcs.events",
    "metrics": "phm.gcs.metrics",
    "gcs.web.feed": "phm.gcs.web.feed",
    "view": "phm.gcs.web.view",
    "gcs.web.history": "phm.gcs.web.history",
    "gcs.web.requests": "phm.gcs.web.requests",
    "gcs.web.replay": "phm.gcs.web.replay",
    "review.sources": "phm.review.sources",
    "record": "phm.review.record",
    "document": "phm.review.document",
    "Parquet": "phm.review.parquet",
}
RECOVERY = {
    "FaultOpened": "phm.core.model:FaultOpened",
    **{name.replace(".", "/"): f"phm.recovery.{name}" for name in PATH},
}
HOPS = {"ground station": "GCS", "radio": "radio", "serial port or router": "port", "companion (PHM)": "companion"}
"""Names in the diagram and in PHM's own sentence."""
DIAGRAMS = {"config -> daemon": FLOW, "gcs.station -> gcs.fleet_state": GROUND, "FaultOpened": RECOVERY}
PICTURES = {"the air (one container)": "swarm", "ground station -> radio": "hops"}


def names_in(text: str) -> set[str]:
    """The words that can only be names of code."""
    return set(CODE_LIKE.findall(text)) - FILES


def wrong_names(text: str, names: dict[str, str]) -> list[str]:
    """What is in the diagram and not in the code, and the reverse."""
    options = {name for name in names_in(text) if name.startswith("--")}
    lost = [name for name in names if not re.search(rf"(?<![\w/]){re.escape(name)}(?![\w/])", text)]
    for place in names.values():
        resolve_name(place)
    return [*sorted(names_in(text) - options - set(names)), *lost, *filter(_not_of_gcs, sorted(options))]


def _not_of_gcs(option: str) -> bool:
    return bool(of_phm(["gcs", option]))


def swarm(block: Block) -> None:
    """The containers and endpoints that `sitl.swarm.config` writes, and the networks of compose.swarm.yaml."""
    compose = (ROOT / "docker" / "compose.swarm.yaml").read_text("utf-8")
    assert names_in(block.text) == {config.APP} and f"  {config.APP}:" in compose
    endpoints = set(re.findall(r"endpoint `(\w+)`, (?:TCP|UDP)", block.text))
    assert endpoints == {endpoint["name"] for endpoint in config.endpoints(Options(), 1)}, str(block)
    assert set(re.findall(r"NAME-K_(\w+)", block.text)) == {"net"} and "networks: [net]" in compose


def hops(block: Block) -> None:
    """In the order of PHM's own sentence about the path."""
    app = {"name": "app", "recover": True}
    world = PathWorld(url="/dev/ttyUSB0", containers=[app])
    world.docker.put(testing.container("app"))
    world.run(20.0)
    said = re.findall(r"(\w+) ok", world.text("path"))
    assert [HOPS.get(name, name) for name in block.text.strip().split(" -> ")] == said


@pytest.mark.parametrize(
    "block", [block for words in (*DIAGRAMS, *PICTURES) for block in containing("text", words)], ids=str
)
def test_a_diagram_has_names_of_the_code(block: Block) -> None:
    """Each of its modules, classes, options, endpoints and hops exists under this name."""
    names = next((DIAGRAMS[words] for words in DIAGRAMS if words in block.text), None)
    if names is not None:
        assert wrong_names(block.text, names) == [], str(block)
    elif "the air (one container)" in block.text:
        swarm(block)
    else:
        hops(block)


def test_a_wrong_name_in_a_diagram_is_found() -> None:
    """A module or option that does not exist, and one that the diagram lost."""
    assert wrong_names("gcs.stations -> x", {}) == ["gcs.stations"]
    assert wrong_names("(--jsons)", {}) == ["--jsons"] and wrong_names("x", {"bus": "phm.core.bus"}) == ["bus"]
    with pytest.raises((AttributeError, ImportError)):
        wrong_names("bus", {"bus": "phm.core.omnibus"})


@pytest.mark.parametrize("block", containing("text", "COMMAND_ACK"), ids=str)
def test_the_console_of_mavproxy_names_what_phm_answers(block: Block) -> None:
    """The component is PHM's; each command gets the answer of the block, before and after `signing key`."""
    signed, component, answers = False, 0, 0
    for line in block.text.splitlines():
        words = line.split()
        if words[:2] == ["set", "target_component"]:
            component = int(words[2])
        if words[0] == "signing":
            signed = True
        if words[0] == "long":
            assert component == testing.settings().mavlink.component_id
            number = getattr(mavlink, f"MAV_CMD_{words[1]}")
            got = Scene(*ALL, signs=True).result(long(number, *map(float, words[2:3])), signed=signed)
            assert f"Got COMMAND_ACK: {words[1]}: {got.name}" in line, f"{block}: {line}"
            answers += 1
            if "not among mavlink.commands" in line:
                assert Scene().result(long(number, float(words[2])), signed=True) is CommandResult.DENIED
    assert answers == 2


@pytest.mark.parametrize("block", containing("text", "operate: "), ids=str)
def test_the_file_of_tokens_is_accepted(block: Block, tmp_path: Path) -> None:
    """`phm gcs --web --token-file` reads it."""
    file = tmp_path / "tokens"
    file.write_text(block.text)
    file.chmod(0o600)
    found = read_tokens(str(file))
    assert found.view and found.operate and found.view != found.operate


@pytest.mark.parametrize("block", containing("text", "yaml-language-server"), ids=str)
def test_the_line_is_the_first_of_the_shipped_file(block: Block) -> None:
    """config/phm.yaml begins with it, and the schema that it names is beside it."""
    assert (ROOT / "config" / "phm.yaml").read_text("utf-8").startswith(block.text)
    assert (ROOT / "config" / block.text.strip().partition("$schema=")[2]).is_file()
