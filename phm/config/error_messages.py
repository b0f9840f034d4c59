"""pydantic's errors as sentences for the user of a YAML file."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from pydantic import BaseModel

from phm.config.problems import Path, listed, shown, unknown
from phm.config.schema_lookup import field_at, model_at, models_of, range_of, unit_of
from phm.config.yaml_scalars import resolve

# By pattern of `phm.core.settings`; a test finds patterns without a description.
PATTERNS = {
    r"^[A-Za-z0-9]+://.+": "a URL of Apprise, e.g. json://hooks.example.org/phm or mqtt://broker.local/alerts",
    r"^[A-Za-z0-9][A-Za-z0-9_.-]*$": "letters, digits, '_', '.' and '-', the first a letter or a digit",
    r"^/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*$": "a ROS name such as /agent_1/node_1: "
    "words of letters, digits and '_' that start with no digit, with '/' between",
    r"^[a-z][a-z0-9_]*(\[\d{1,5}\])?(\.[a-z][a-z0-9_]*(\[\d{1,5}\])?)*$": "the name of a field, e.g. pose.position.z or cells[0].voltage",
    r"^[A-Za-z][A-Za-z0-9_]*(\[\d{1,3}\])?$": "the name of a field, e.g. battery_remaining or voltages[0]",
    r"^[A-Z][A-Z0-9_]*$": "the name of a MAVLink message in capital letters, e.g. BATTERY_STATUS",
    r"^/dev/.": "a path below /dev",
    r"^[a-z][a-z0-9_]*/srv/[A-Z][A-Za-z0-9]*$": "package/srv/Type, such as std_srvs/srv/Trigger",
    r"^/": "an absolute path, one that starts with '/'",
    r"^[a-z][a-z0-9_]*(\.[a-z][a-z0-9_]*)*$": "the name of a field, e.g. twist.linear.x, without an index",
    r"^[^/]+$": "a name, or a pattern with '*' and '?', without '/'",
    r"^/dev/([^*?/]+/)*[^/]+$": "a path below /dev, with '*' and '?' only in its last part",
    r"^/[^:]*$": "an absolute path, one that starts with '/', without ':'",
    r"^[0-9a-fA-F]{64}$": "64 hexadecimal digits, as sha256sum prints",
    r"^(image|/.*)$": "'image', or an absolute path that PHM sees",
    r"^[^=\s]+(=.*)?$": "'key' or 'key=value' without spaces in the key",
    r"^[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*$": "package/msg/Type, such as std_msgs/msg/String",
    r"^(tcp|tls|quic)/([A-Za-z0-9_.-]+|\[[0-9A-Fa-f:.]+\]):[0-9]{1,5}$": "tcp/HOST:PORT, tls/HOST:PORT or quic/HOST:PORT",
    r"^[A-Za-z0-9_.:-]+$": "the name or IP address of a host",
    r"^[ -~]+$": "printable ASCII characters",
    r"^https?://[^\s/@]+(/[!-~]*)?$": "http://HOST[:PORT]/PATH or https://..., without spaces and passwords",
    r"^([A-Za-z0-9_.-]+|\[[0-9A-Fa-f:.]+\]):[0-9]{1,5}$": "HOST:PORT, e.g. 127.0.0.1:9464 or [::1]:9464",
    r"^(unix:///.+|tcp://.+)$": "unix:///path or tcp://host:port",
}
_WANTED = {
    "int_type": "a whole number",
    "float_type": "a number",
    "bool_type": "true or false",
    "string_type": "text",
    "list_type": "a list",
    "dict_type": "a mapping",
    "model_type": "a section with keys",
    "model_attributes_type": "a section with keys",
    "string_unicode": "text that is valid Unicode",
    "int_from_float": "a whole number",
    "int_parsing_size": "a smaller number",
}
_SECTIONS = {"model_type", "model_attributes_type"}
_PLAIN = re.compile(r"[A-Za-z_/.]([\w/.@=+:-]*[\w/])?")
"""Text that needs no quotes, also inside [] and {}."""
_HINTED = 60
_RANGES = {"greater_than_equal", "greater_than", "less_than_equal", "less_than", "finite_number"}


def sentence(error: Mapping[str, Any]) -> str:
    """What is wrong and what is allowed, for one entry of `ValidationError.errors()`."""
    kind, path, value = str(error["type"]), tuple(error["loc"]), error.get("input")
    context: Mapping[str, Any] = error.get("ctx", {})
    if kind == "extra_forbidden":
        return _unknown_key(path)
    if kind == "missing":
        return f"is missing{_description(path)}"
    if kind == "value_error":
        return str(context.get("error", error["msg"]))
    if kind == "union_tag_invalid":
        allowed = re.findall(r"'([^']*)'", str(context.get("expected_tags")))
        return unknown("type", str(context.get("tag")), allowed)
    if kind == "union_tag_not_found":
        return "is missing: it says what the entry is, and which keys it has"
    if kind in _WANTED:
        return _wrong_type(kind, path, value)
    if kind in _RANGES:
        field = field_at(path)
        return f"is {shown(value)}, {(range_of(field) if field else '') or 'expected a finite number'}"
    if kind == "string_pattern_mismatch":
        pattern = str(context.get("pattern"))
        return f"is {shown(value)}, allowed is {PATTERNS.get(pattern, f'text that matches {pattern}')}"
    if kind == "literal_error":
        allowed = re.findall(r"'([^']*)'", str(context.get("expected")))
        return f"is {shown(value)}, allowed are {listed(allowed)}"
    if kind == "string_too_long":
        return f"is {shown(value)}, allowed are at most {context.get('max_length')} characters"
    if kind == "string_too_short":
        return "is empty, expected at least one character"
    return f"is {shown(value)}: {error['msg']}"


def of_alternatives(errors: Sequence[Mapping[str, Any]]) -> str:
    """The same for a value of which pydantic reports each type that it may have: what is wrong if it has one of them, else all types."""
    for error in errors:
        if error["type"] not in _WANTED:
            return sentence(error)
    words = sorted((_WANTED[str(error["type"])] for error in errors), key=lambda words: " or " not in words)
    return f"is {_what(errors[0].get('input'))}, expected {', '.join(words[:-1])} or {words[-1]}"


def _unknown_key(path: Path) -> str:
    model = model_at(path[:-1])
    return unknown("key", str(path[-1]), model.model_fields if model else ())


def _wrong_type(kind: str, path: Path, value: object) -> str:
    field = field_at(path)
    wanted = _WANTED[kind]
    unit = unit_of(field) if field else ""
    if kind == "float_type" and unit:
        wanted = f"a number of {unit}"
    hint = ""
    if value is None:
        hint = " (give it a value or remove the key)"
    elif kind == "string_type" and not isinstance(value, (list, dict)):
        hint = " (put it in quotes)"
    elif kind == "bool_type" and str(value).lower() in ("yes", "on", "no", "off"):
        hint = f" (write {'true' if str(value).lower() in ('yes', 'on') else 'false'})"
    elif kind == "list_type" and not isinstance(value, dict):
        entries = _entries(path, value)
        hint = f" (write [{entries}])" if entries else " (write the entries between '[' and ']')"
    elif kind in _SECTIONS and isinstance(path[-1], int) and (entry := _entry(path, value)):
        hint = f" (write {entry})"
    return f"is {_what(value)}, expected {wanted}{hint}"


def _entries(path: Path, value: object) -> str:
    """The value as entries of the list at `path`; empty where they are not clear. What is hinted is allowed inside [] and {}, too."""
    parts = [part.strip() for part in value.split(",")] if isinstance(value, str) else [value]
    entries = [_entry((*path, 0), part) for part in parts]
    text = ", ".join(entries)
    return text if all(entries) and len(text) <= _HINTED else ""


def _entry(path: Path, value: object) -> str:
    """The value as an entry of a list: unchanged, or with the key that the entry needs. Empty where that is not clear."""
    plain = isinstance(value, str) and _PLAIN.fullmatch(value) and isinstance(resolve(value), str)
    field = field_at(path)
    models = models_of(field.annotation) if field else ()
    if not models:
        return str(value) if plain or type(value) in (int, float) else ""
    key = _only_key(models[0]) if len(models) == 1 else ""
    return f"{{{key}: {value}}}" if plain and key else ""


def _only_key(model: type[BaseModel]) -> str:
    """The key that an entry cannot do without; `name` where there are several ways to name it."""
    required = [name for name, field in model.model_fields.items() if field.is_required()]
    if not required and "name" in model.model_fields:
        return "name"
    return required[0] if len(required) == 1 else ""


def _what(value: object) -> str:
    if value is None:
        return "empty"
    if isinstance(value, bool):
        return f"{str(value).lower()}"
    if isinstance(value, str):
        return f"text {shown(value)}"
    if isinstance(value, int):
        return f"the whole number {shown(value)}"
    if isinstance(value, float):
        return f"the number {shown(value)}"
    return "a list" if isinstance(value, list) else "a mapping"


def _description(path: Path) -> str:
    field = field_at(path)
    return f": {field.description.rstrip('.')}" if field and field.description else ""
