"""The Compose lines with which a container takes a delivered configuration fit the Compose files that PHM ships."""

from __future__ import annotations

import errno
import re
from pathlib import Path
from typing import Any

import yaml

from phm.config.loader import DELIVERED
from phm.runtime.delivery import _not_written
from tests.docs.blocks import containing
from tests.docs.examples import ROOT
from tests.setup.test_template_renderer import made

PAGE = "docs/guides/checks-page.md"
FILE = "/etc/phm/phm.yaml"


def override() -> dict[str, Any]:
    """The service `phm` of the page's compose.override.yaml."""
    (block,) = (block for block in containing("yaml", f":{DELIVERED} #") if block.page == PAGE)
    service: dict[str, Any] = yaml.safe_load(block.text)["services"]["phm"]
    return service


def test_the_override_of_the_page_is_that_of_phm_init() -> None:
    """The same folder, variable and port; the commands on the page fill this folder."""
    written = yaml.safe_load(made(deliver=("10.0.0.7", 9465))["compose.override.yaml"])["services"]["phm"]
    assert override() == written
    (volume,) = override()["volumes"]
    folder, target = volume.split(":")
    assert (folder, target) == ("./delivered", DELIVERED)
    text = (ROOT / PAGE).read_text("utf-8")
    for command in ("mkdir", "mv phm.yaml delivery.key", "sudo chown -R 10001:10001"):
        assert re.search(rf"^ *\$ {command} delivered/?$", text, re.MULTILINE), command


def test_the_published_port_is_the_one_that_the_ground_calls() -> None:
    """The address of the host in the override is that of the command on the same page."""
    (port,) = override()["ports"]
    address, _, inside = port.rpartition(":")
    text = (ROOT / PAGE).read_text("utf-8")
    assert f"--deliver a07.yaml {address} " in text and f"0.0.0.0:{inside}`" in text


def test_the_refusal_names_what_permits_deliveries() -> None:
    """The file of the repository, and the lines that it and `phm init --deliver` add."""
    text = _not_written(Path(FILE), OSError(errno.EROFS, "Read-only file system"))
    overlay = yaml.safe_load((ROOT / "docker" / "compose.deliver.yaml").read_text("utf-8"))["services"]["phm"]
    assert "docker/compose.deliver.yaml" in text and "`--deliver`" in text
    for service in (overlay, override()):
        (volume,) = service["volumes"]
        assert f"`- FOLDER:{volume.rpartition(':')[2]}`" in text
        assert f"`PHM_CONFIG: {service['environment']['PHM_CONFIG']}`" in text
