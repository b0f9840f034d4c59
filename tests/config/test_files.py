"""The files in config/: every key documented with its default and range, examples valid, schema up to date."""

from __future__ import annotations

import json
import operator
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import jsonschema
import pytest
from click.testing import CliRunner
from pydantic import BaseModel, BeforeValidator, TypeAdapter
from pydantic.fields import FieldInfo

from phm.cli.validate import command
from phm.config import load, loads, schema
from phm.config.env_expansion import Expander
from phm.config.error_messages import PATTERNS
from phm.config.schema_lookup import bound, field_at, metadata, models_of
from phm.config.yaml_tree import parse
from phm.core.settings import Settings

CONFIG = Path(__file__).resolve().parents[2] / "config"
DEMO = CONFIG.parent / "phm" / "simulation" / "demo.yaml"
SHIPPED = sorted([CONFIG / "phm.yaml", DEMO, *(CONFIG / "examples").glob("*.yaml")])
KEY = re.compile(r"^(?P<indent> *)#?(?P<dash>(?:- )?)#?(?P<key>[a-z_0-9]+):(?: |$)")
PROSE = re.compile(r"^ *# (?P<text>.*)$")
QUOTED = re.compile(r"`([^`]*)`")


@dataclass(frozen=True)
class Entry:
    """One key of phm.yaml: its path without indexes and names of checks, and the comment above it."""

    path: tuple[str, ...]
    prose: str


def entries(text: str) -> list[Entry]:
    """All keys of the file, including commented ones (`#key:`), by their indentation."""
    found: list[Entry] = []
    stack: list[tuple[int, str]] = []
    prose: list[str] = []
    for line in text.splitlines():
        if comment := PROSE.match(line):
            prose.append(comment["text"])
        elif key := KEY.match(line):
            indent = len(key["indent"] + key["dash"])
            while stack and stack[-1][0] >= indent:
                stack.pop()
            stack.append((indent, key["key"]))
            path = tuple(name for _, name in stack)
            found.append(Entry(path[:1] + path[2:] if path[0] == "checks" else path, " ".join(prose)))
            prose = []
        else:
            prose = []
    return found


def fields(
    model: type[BaseModel] = Settings, path: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], FieldInfo]]:
    """Every field of the models, with its path."""
    for name, field in model.model_fields.items():
        yield (*path, name), field
        for inner in models_of(field.annotation):
            yield from fields(inner, (*path, name))


FIELDS = dict(fields())
DOCUMENTED = {entry.path: entry.prose for entry in reversed(entries((CONFIG / "phm.yaml").read_text()))}


def is_section(field: FieldInfo) -> bool:
    """A section whose keys have the defaults, unlike a Limit, whose keys are required."""
    annotation = field.annotation
    return (
        isinstance(annotation, type)
        and issubclass(annotation, BaseModel)
        and not any(inner.is_required() for inner in annotation.model_fields.values())
    )


def annotated(kind: Any, extras: list[Any]) -> Any:
    """`Annotated[kind, *extras]`, which Python 3.10 cannot express."""
    return operator.getitem(Annotated, (kind, *extras)) if extras else kind


def value_of(written: str, field: FieldInfo) -> Any:
    """A value in a comment: parsed as YAML, then by the field's own type."""
    tree = parse(f"x: {written}", "prose", Expander({}))
    assert not tree.problems
    kind: Any = field.annotation
    if field.metadata:
        kind = annotated(kind, [entry for entry in field.metadata if not hasattr(entry, "ge")])
    return TypeAdapter(kind).validate_python(tree.data["x"])


def test_phm_yaml_has_exactly_the_keys_of_the_model() -> None:
    """Keys of the documented file and of the models are the same set."""
    assert set(DOCUMENTED) == set(FIELDS)


@pytest.mark.parametrize("path", FIELDS, ids=".".join)
def test_a_key_is_documented_with_its_default(path: tuple[str, ...]) -> None:
    """The comment above a key explains it and states the model's default, or that it is required."""
    field, prose = FIELDS[path], DOCUMENTED[path]
    assert len(prose) > 10
    if is_section(field):
        return
    if field.is_required():
        assert "Required." in prose
        return
    stated = re.search(r"Default: `([^`]*)`", prose)
    assert stated, prose
    assert value_of(stated[1], field) == field.get_default(call_default_factory=True)


RANGED = [path for path, field in FIELDS.items() if bound(field, "ge", "gt", "le", "lt") is not None]


@pytest.mark.parametrize("path", RANGED, ids=".".join)
def test_a_number_is_documented_with_its_range(path: tuple[str, ...]) -> None:
    """The comment states the lowest and the highest value that the model allows."""
    field, allowed = FIELDS[path], DOCUMENTED[path].partition("Allowed: ")[2].partition("Default")[0]
    limits = [limit for limit in (bound(field, "ge", "gt"), bound(field, "le", "lt")) if limit is not None]
    stated = [
        TypeAdapter(_kind(field)).validate_python(parse(f"x: {text}", "", Expander({})).data["x"])
        for text in QUOTED.findall(allowed)
        if text.removeprefix("-")[0].isdigit()
    ]
    assert stated == limits
    assert bool(re.search(r"(?<!not )above `", allowed)) == (bound(field, "gt") is not None)


def _kind(field: FieldInfo) -> Any:
    """The field's type without its range: only the unit remains."""
    base = next((part for part in get_args(field.annotation) if part is not type(None)), field.annotation)
    while get_origin(base) is Annotated:
        base = get_args(base)[0]
    units = [entry for entry in metadata(field) if isinstance(entry, BeforeValidator)]
    return annotated(base, units)


CHOICES = [path for path, field in FIELDS.items() if field.annotation is bool or "Literal" in str(field.annotation)]


@pytest.mark.parametrize("path", CHOICES, ids=".".join)
def test_a_choice_is_documented_with_all_allowed_values(path: tuple[str, ...]) -> None:
    """The comment lists exactly the words that the model accepts."""
    field, allowed = FIELDS[path], DOCUMENTED[path].partition("Allowed: ")[2].partition("Default")[0]
    words = ["true", "false"] if field.annotation is bool else _words_at(path)
    assert QUOTED.findall(allowed) == words


def _words_at(path: tuple[str, ...]) -> list[str]:
    """All words at a path; `type` of a list has one in each of its models."""
    same = [field for place, field in fields() if place == path]
    return list(dict.fromkeys(word for field in same for word in _words(field.annotation)))


def _words(annotation: Any) -> list[str]:
    """The words of a Literal, also of one in a list."""
    return [word for part in get_args(annotation) for word in ([part] if isinstance(part, str) else _words(part))]


def test_every_commented_key_may_be_uncommented() -> None:
    """With all `#key:` and `#- key:` set, the file is still valid."""
    text = re.sub(r"^( *)#(?=(?:- )?[a-z_0-9]+:)", r"\1", (CONFIG / "phm.yaml").read_text(), flags=re.MULTILINE)
    tree = parse(text, "phm.yaml", Expander({}))
    assert not tree.problems
    assert isinstance(Settings.model_validate(tree.data, strict=True), Settings)


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_a_shipped_file_is_valid(path: Path) -> None:
    """`phm validate` accepts each shipped file, with the installed checks, and exits 0."""
    done = CliRunner().invoke(command, ["-c", str(path)], env={"PHM_INTERVAL": ""})
    assert done.exit_code == 0, done.output
    assert done.stdout.startswith(f"{path}: valid, agent ")


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.name)
def test_a_shipped_file_fits_the_schema_before_variables_are_expanded(path: Path) -> None:
    """An editor with the schema shows no error in our files."""
    data = parse(path.read_text().replace("${", "$${"), path.name, Expander({})).data
    jsonschema.Draft202012Validator(json.loads((CONFIG / "phm.schema.json").read_text())).validate(data)


@cache
def made() -> dict[str, Any]:
    """The schema of the models."""
    return schema.schema()


@pytest.mark.parametrize(
    "data",
    [
        {"intervall": 5},
        {"interval": "5 Hz"},
        {"agent": {"id": "seven"}},
        {"containers": {}},
        {"recovery": {"mode": "acct"}},
        {"agent": {"name": "a b"}},
        {"checks": {"a": {"perod": 1}}},
    ],
)
def test_the_schema_rejects_what_the_models_reject(data: dict[str, Any]) -> None:
    """An editor with the schema shows these mistakes."""
    assert not jsonschema.Draft202012Validator(made()).is_valid(data)


def test_the_schema_is_one() -> None:
    """It follows the rules of its draft."""
    jsonschema.Draft202012Validator.check_schema(made())


def test_the_schema_describes_every_key() -> None:
    """Each property of the schema has a description, so that an editor can show it."""
    whole = made()
    for section in [whole, *whole["$defs"].values()]:
        for name, value in section.get("properties", {}).items():
            own_section = whole["$defs"].get(value.get("$ref", "").rpartition("/")[2], {})
            assert value.get("description") or own_section.get("description"), name


def test_the_schema_file_is_up_to_date(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`--check` accepts the committed file and rejects another one with the command that fixes it."""
    assert schema.main(["--check"]) == 0
    stale = tmp_path / "phm.schema.json"
    stale.write_text("{}")
    assert schema.main(["--check", str(stale)]) == 1
    assert "python -m phm.config.schema" in capsys.readouterr().err
    assert stale.read_text() == "{}"
    assert schema.main([str(stale)]) == 0
    assert schema.main(["--check", str(stale)]) == 0


def test_one_file_serves_an_entire_swarm() -> None:
    """The variables of phm.yaml set names, numbers, nodes, topics and the endpoint."""
    environ = {
        "PHM_AGENT": "scout_7",
        "PHM_AGENT_ID": "7",
        "PHM_APP": "swarm-app-1",
        "PHM_NETWORK": "swarm",
        "PHM_DEVICE": "/dev/ttyACM0",
        "PHM_MAVLINK": "tcp:gcs:5760",
        "PHM_AUTOPILOT": "true",
    }
    read = load(CONFIG / "phm.yaml", environ=environ)
    assert (read.agent.name, read.agent.id) == ("scout_7", 7)
    assert read.containers[0].name == "swarm-app-1"
    assert read.containers[0].networks == ["swarm"]
    assert read.containers[0].devices[0].path == "/dev/ttyACM0"
    assert [node.name for node in read.ros.nodes] == [f"/scout_7/node_{number}" for number in (1, 2, 3)]
    assert [topic.subscribers for topic in read.ros.topics] == [[f"/scout_7/node_{number}"] for number in (2, 3, 1)]
    assert read.mavlink.endpoints[0].url == "tcp:gcs:5760"
    assert read.mavlink.autopilot


def test_values_in_phm_yaml_equal_the_defaults_except_for_the_application() -> None:
    """Sections about PHM itself repeat the defaults, so copying the file changes nothing unnoticed."""
    read, plain = load(CONFIG / "phm.yaml", environ={}), loads("{}", environ={})
    for section in ("agent", "interval", "host", "recovery", "log", "docker", "run_dir"):
        assert getattr(read, section) == getattr(plain, section), section


def test_every_pattern_of_the_models_has_a_description() -> None:
    """No message shows a regular expression."""
    patterns = {
        entry.pattern for field in FIELDS.values() for entry in metadata(field) if getattr(entry, "pattern", None)
    }
    patterns |= set(re.findall(r"pattern='([^']*)'", str([*FIELDS.values()])))
    assert patterns
    assert {str(pattern) for pattern in patterns} <= set(PATTERNS) | {
        pattern.replace("\\", "\\\\") for pattern in PATTERNS
    }


def test_the_field_of_a_path_is_found_through_lists_and_mappings() -> None:
    """Ranges and units in messages come from the last field of a path."""
    assert field_at(("containers", 0, "files", 1, "path")) is FIELDS["containers", "files", "path"]
    assert field_at(("checks", "nodes", "period")) is FIELDS["checks", "period"]
    assert field_at(("ros", "topics", 2, "publishers", 0)) is FIELDS["ros", "topics", "publishers"]
    assert field_at(("nothing",)) is None
