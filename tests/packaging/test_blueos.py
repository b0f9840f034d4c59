"""The image's labels and the page's endpoint have the shapes that BlueOS documents for its extensions, and that it reads.

https://blueos.cloud/docs/latest/development/extensions/, the README of bluerobotics/BlueOS-Extensions-Repository, and the models
in bluerobotics/BlueOS. No BlueOS runs here; docs/guides/blueos.md says which of its programs were run by hand.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from phm import __version__
from phm.core.clock import SystemClock
from phm.gcs.web.agent_page import AgentPage
from phm.gcs.web.options import ListenOptions
from tests.fakes.until import until
from tests.gcs.web.swarm import Client

ROOT = Path(__file__).resolve().parents[2]
PERSON = {
    "type": "object",
    "required": ["name", "email"],
    "properties": {
        "name": {"type": "string", "minLength": 1},
        "email": {"type": "string", "pattern": "^[^@ ]+@[^@ ]+$"},
    },
}
URL = {"type": "string", "pattern": "^(https|mailto):"}
PORTS = {"type": "object", "patternProperties": {"^[0-9]+/(tcp|udp)$": {}}, "additionalProperties": False}
SHAPES: dict[str, dict[str, Any]] = {
    "authors": {"type": "array", "minItems": 1, "items": PERSON},
    "company": {**PERSON, "required": ["about", "name", "email"]},
    "links": {"type": "object", "additionalProperties": URL},
    "tags": {"type": "array", "maxItems": 10, "items": {"type": "string", "pattern": "^[a-z0-9-]+$"}},
    "permissions": {
        "type": "object",
        "required": ["ExposedPorts", "HostConfig"],
        "properties": {
            "ExposedPorts": PORTS,
            "HostConfig": {
                "type": "object",
                "required": ["PortBindings"],
                "properties": {
                    "PortBindings": PORTS,
                    "Binds": {"type": "array", "items": {"type": "string", "pattern": "^/[^:]+:/[^:]+(:ro|:rw)?$"}},
                },
            },
        },
    },
}
SERVICE = {
    "type": "object",
    "required": ["name", "description", "icon", "company", "version", "webpage", "api"],
    "properties": {
        **{key: {"type": "string"} for key in ("description", "company", "version", "webpage", "api")},
        "name": {"type": "string", "minLength": 1},
        "icon": {"type": "string", "pattern": "^mdi-[a-z-]+$"},
        **{key: {"type": "boolean"} for key in ("new_page", "avoid_iframes", "works_in_relative_paths")},
        **{key: {"type": "string"} for key in ("route", "extra_query")},
        "extras": {"type": "object", "additionalProperties": {"type": "string"}},
    },
    "additionalProperties": False,
}
"""The fields of `ServiceMetadata` in BlueOS' core/services/helper/main.py, except the one that BlueOS sets itself."""


def labels() -> dict[str, str]:
    """Those of the sidecar's stage, as the builder reads them."""
    text = (ROOT / "docker" / "Dockerfile").read_text("utf-8")
    stage = text.partition(" AS sidecar\n")[2].partition("\nFROM ")[0].replace("\\\n", "")
    return {name: value for name, _, value in re.findall(r"^LABEL (\w+)=(['\"])(.*)\2$", stage, re.MULTILINE)}


@pytest.mark.parametrize("name", SHAPES)
def test_a_label_is_json_of_the_documented_shape(name: str) -> None:
    """BlueOS reads it with a JSON parser."""
    jsonschema.validate(json.loads(labels()[name]), SHAPES[name])


def test_the_plain_labels_are_as_documented() -> None:
    """The version is that of the package and a semantic version; the type one of the six that BlueOS reads."""
    found = labels()
    assert set(found) == {*SHAPES, "version", "readme", "type", "requirements"}
    assert found["version"] == __version__ and re.fullmatch(r"\d+\.\d+\.\d+", found["version"])
    assert found["type"] in ("device-integration", "example", "theme", "other", "tool", "education")
    assert found["readme"].startswith("https://") and found["readme"].endswith(".md") and "{tag}" in found["readme"]
    assert found["requirements"] == "core >= 1.2", "1.1 opens every page in a frame, which the page does not allow"


def test_the_extension_has_no_more_rights_than_the_compose_file() -> None:
    """Without capabilities, read-only, and with the page's port alone; the page asks for a token."""
    permissions = json.loads(labels()["permissions"])
    host = permissions["HostConfig"]
    assert host["CapDrop"] == ["ALL"] and host["ReadonlyRootfs"] is True and "Privileged" not in host
    assert host["SecurityOpt"] == ["no-new-privileges:true"]
    assert set(permissions["ExposedPorts"]) == set(host["PortBindings"]) == {"8080/tcp"}
    command = permissions["Cmd"][-1]
    assert "--token-file" in command and "exec phm run" in command
    compose = (ROOT / "docker" / "compose.yaml").read_text("utf-8")
    for bind in host["Binds"]:
        assert bind.split(":")[1] in compose, f"{bind} is not in docker/compose.yaml"


def test_the_page_says_to_blueos_what_it_is(tmp_path: Path) -> None:
    """BlueOS asks `/` and then `/register_service`, as a program of this machine; the answer names nothing of the vehicle."""
    page = AgentPage(lambda: ({}, "no status"), ListenOptions(port=0), SystemClock())
    page.start()
    client = Client(page.server.address)
    try:
        until(lambda: client.ask("GET", "/")[0] == 200, "the page")
        found = client.get("/register_service")
        jsonschema.validate(found, SERVICE)
        assert found["version"] == __version__
        assert client.ask("GET", "/")[2].headers["X-Frame-Options"] == "DENY"
        assert found["avoid_iframes"], "with new_page alone BlueOS opens its own page that frames this one"
    finally:
        page.close()
