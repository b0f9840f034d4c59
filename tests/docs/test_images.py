"""Dockerfile blocks of the documents: instructions that Docker knows, and names of PHM's own image."""

from __future__ import annotations

import json
import re
import shlex

import pytest

from tests.docs.blocks import Block, blocks
from tests.docs.examples import ROOT
from tests.docs.test_commands import of_phm

SHIPPED = (ROOT / "docker" / "Dockerfile").read_text("utf-8")
COMPOSE = (ROOT / "docker" / "compose.yaml").read_text("utf-8")
HEALTH_OPTIONS = frozenset({"interval", "timeout", "start-period", "start-interval", "retries"})
DURATION = re.compile(r"(?:\d+(?:ms|s|m|h))+")


def of_health_check(words: str) -> str:
    """Why HEALTHCHECK is not accepted."""
    options = dict(word[2:].split("=", 1) for word in shlex.split(words.partition(" CMD ")[0]) if word.startswith("--"))
    command = json.loads(words.partition(" CMD ")[2])
    if not set(options) <= HEALTH_OPTIONS:
        return f"{sorted(set(options) - HEALTH_OPTIONS)} are no options of HEALTHCHECK"
    wrong = [name for name, value in options.items() if name != "retries" and not DURATION.fullmatch(value)]
    if wrong or command[0] != "phm":
        return f"{wrong} is not a duration" if wrong else "the command is not PHM's"
    return of_phm(command[1:])


def refused(line: str) -> str:
    """Why an instruction is wrong for an image that is built on PHM's; empty: it is right."""
    instruction, _, rest = line.partition(" ")
    match instruction:
        case "FROM":
            return "" if f"${{PHM_IMAGE:-{rest}}}" in COMPOSE else f"{rest} is not the image of docker/compose.yaml"
        case "COPY":
            target = rest.split()[-1]
            return "" if f" {target}\n" in SHIPPED else f"PHM's image has no {target}"
        case "HEALTHCHECK":
            return of_health_check(rest)
    return f"{instruction} is not an instruction that this test understands: add it"


@pytest.mark.parametrize("block", blocks("dockerfile"), ids=str)
def test_a_block_is_a_part_of_a_dockerfile(block: Block) -> None:
    """Each line is an instruction with names of docker/Dockerfile, docker/compose.yaml and `phm`."""
    for line in block.text.splitlines():
        assert not refused(line), f"{block}: {line}: {refused(line)}"


@pytest.mark.parametrize(
    "line",
    [
        "FROM phm:dev",
        "COPY site /opt/other",
        "RUM x",
        'HEALTHCHECK --every=1s CMD ["phm", "status"]',
        'HEALTHCHECK --interval=1x CMD ["phm", "status"]',
        'HEALTHCHECK --interval=1s CMD ["phm", "status", "--healthier"]',
    ],
)
def test_a_wrong_line_is_found(line: str) -> None:
    """Other images, folders, instructions and options."""
    assert refused(line)
