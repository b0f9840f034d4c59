"""Configurations made from the shipped one: what is measured is what users run, but for the lines that are named."""

from __future__ import annotations

import atexit
import re
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from sitl.harness.compose_stack import ROOT

SHIPPED = ROOT / "config" / "phm.yaml"


class _Reader(yaml.CSafeLoader):
    """Only true and false are booleans, as for PHM: on, off, yes and no are ordinary text."""


_Reader.yaml_implicit_resolvers = {
    first: [(tag, form) for tag, form in found if tag != "tag:yaml.org,2002:bool"]
    for first, found in yaml.CSafeLoader.yaml_implicit_resolvers.items()
}
_Reader.add_implicit_resolver("tag:yaml.org,2002:bool", re.compile(r"true|false"), list("tf"))


def parsed(text: str) -> Any:
    """A configuration, or a value of one, as PHM reads it but for units and variables."""
    return yaml.load(text, _Reader)  # noqa: S506, a SafeLoader


def overridden(changes: Mapping[str, str]) -> str:
    """The shipped configuration with each key of `changes` replaced by its value.

    Raises ValueError when a key is not there exactly once: then the shipped file was changed and the caller was not.
    """
    text = SHIPPED.read_text("utf-8")
    for old, new in changes.items():
        if text.count(old) != 1:
            raise ValueError(f"config/phm.yaml has {old.strip()!r} {text.count(old)} times, expected once")
        text = text.replace(old, new)
    return text


def write(text: str, file: Path | None = None) -> Path:
    """Put a configuration where PHM's container, an ordinary user, can read it; a new file, until this program ends, when none is given.

    An existing file keeps its inode, because a container that has it mounted sees that inode alone.
    """
    if file is None:
        folder = Path(tempfile.mkdtemp(prefix="phm-config-"))
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        folder.chmod(0o755)
        file = folder / "phm.yaml"
    file.write_text(text, "utf-8")
    file.chmod(0o644)
    return file
