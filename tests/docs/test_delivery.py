"""The Compose lines with which a container takes a delivered configuration fit the Compose files that PHM ships."""

from __future__ import annotations

import errno
import re
from pathlib import Path
from typing import Any

import yaml

from phm.runtime.delivery import _not_written
from tests.docs.blocks import containing
from tests.docs.examples import ROOT
from tests.setup.test_template_renderer import made

PAGE = "docs/guides/checks-page.md"
FILE = "/etc/phm/phm.yaml"


def override() -> dict[str, Any]:
    """The service `phm` of the page's compose.override.yaml."""
    (block,) = (block for block in containing("yaml", ":/etc/phm #") if block.page == PAGE)
    service: dict[str, Any] = yaml.safe_load(block.text)["services"]["phm"]
    return service


def test_the_override_replaces_the_read_only_folder_of_phm_init() -> None:
    """Compose replaces a volume of the same target; the line that is quoted beside it is the one of `phm init`."""
    (volume,) = override()["volumes"]
    folder, target = volume.split(":")
    assert (folder, target) == ("./config", "/etc/phm")
    volumes = yaml.safe_load(made()["compose.yaml"])["services"]["phm"]["volumes"]
    assert [each for each in volumes if each.split(":")[1] == target] == [".:/etc/phm:ro"]
    text = (ROOT / PAGE).read_text("utf-8")
    assert "instead of `.:/etc/phm:ro`" in text
    assert set(re.findall(r"^\$ (?:cp|mv|mkdir|sudo chown) .*\bconfig/?$", text, re.MULTILINE)) == {
        "$ mkdir config",
        "$ mv phm.yaml delivery.key config/",
        "$ cp *.xml config/",
        "$ sudo chown -R 10001 config",
    }


def test_the_published_port_is_the_one_that_the_ground_calls() -> None:
    """The address of the host in the override is that of the command on the same page."""
    (port,) = override()["ports"]
    address, _, inside = port.rpartition(":")
    text = (ROOT / PAGE).read_text("utf-8")
    assert f"--deliver a07.yaml {address} " in text and f"`listen: 0.0.0.0:{inside}`" in text


def test_the_refusal_names_a_line_of_each_shipped_compose_file() -> None:
    """Both have one that ends as the message says, and only one."""
    text = _not_written(Path(FILE), OSError(errno.EROFS, "Read-only file system"))
    folder, alone = re.findall(r"`(:[^`]*:ro)`", text)
    shipped = (ROOT / "docker" / "compose.yaml").read_text("utf-8")
    for compose, ending in ((made()["compose.yaml"], folder), (shipped, alone)):
        volumes = yaml.safe_load(compose)["services"]["phm"]["volumes"]
        assert len([volume for volume in volumes if volume.endswith((folder, alone))]) == 1
        assert [volume for volume in volumes if volume.endswith(ending)]
