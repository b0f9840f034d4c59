"""The JSON schema of `phm.yaml` for editors, generated from the models: `python -m phm.config.schema [--check]`.

Draft 2020-12. Where the models expect a number, a boolean or a pattern, a text with `${VAR}` is allowed, too,
because variables are replaced before validation.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from phm.core.settings import Settings

TARGET = Path(__file__).resolve().parents[2] / "config" / "phm.schema.json"
_VARIABLE = {"$ref": "#/$defs/Variable"}
_PLAIN = ("integer", "number", "boolean")


def schema() -> dict[str, Any]:
    """The schema as JSON-able values."""
    made = Settings.model_json_schema(mode="validation")
    definitions = {name: _section(section) for name, section in made.pop("$defs").items()}
    definitions["Variable"] = {
        "description": "A text with variables, which are replaced before validation: ${NAME} or ${NAME:-default}.",
        "type": "string",
        "pattern": r"\$\{[A-Za-z_][A-Za-z0-9_]*(:-[^}]*)?\}",
    }
    head = {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "phm.yaml"}
    return {**head, **{key: value for key, value in _section(made).items() if key != "title"}, "$defs": definitions}


def text() -> str:
    """The content of the schema file."""
    return json.dumps(schema(), indent=2, ensure_ascii=False) + "\n"


def _section(section: dict[str, Any]) -> dict[str, Any]:
    properties = {name: _value(value) for name, value in section.get("properties", {}).items()}
    return {**section, "properties": properties}


def _value(value: dict[str, Any]) -> dict[str, Any]:
    """One property, or one entry of a list or a mapping, with variables allowed."""
    value = {key: entry for key, entry in value.items() if key != "title"}
    for inner in ("items", "additionalProperties"):
        if isinstance(value.get(inner), dict):
            value[inner] = _value(value[inner])
    if not _wants_more_than_text(value):
        return value
    kept: dict[str, Any] = {key: value.pop(key) for key in ("description", "default") if key in value}
    choices = value.pop("anyOf") if set(value) == {"anyOf"} else [value]
    return {**kept, "anyOf": [*choices, _VARIABLE]}


def _wants_more_than_text(value: dict[str, Any]) -> bool:
    if "anyOf" in value:
        return any(_wants_more_than_text(choice) for choice in value["anyOf"])
    return value.get("type") in _PLAIN or any(key in value for key in ("pattern", "enum"))


def main(arguments: list[str] | None = None) -> int:
    """Write the schema file, or with `--check` compare it; 0 when it is up to date."""
    parser = argparse.ArgumentParser(prog="python -m phm.config.schema", description="Generate the schema of phm.yaml.")
    parser.add_argument("--check", action="store_true", help="change nothing; exit 1 when the file is not up to date")
    parser.add_argument("file", nargs="?", type=Path, default=TARGET, help="default: config/phm.schema.json")
    options = parser.parse_args(arguments)
    target: Path = options.file
    if not options.check:
        target.write_text(text(), encoding="utf-8")
        return 0
    if target.is_file() and target.read_text(encoding="utf-8") == text():
        return 0
    sys.stderr.write(f"{target.name} does not match phm/core/settings: run 'python -m phm.config.schema'\n")
    return 1


if __name__ == "__main__":
    sys.exit(main())
