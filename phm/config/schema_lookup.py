"""Looks up a place of the tree in the models: its allowed keys, range and unit."""

from __future__ import annotations

from collections.abc import Iterator
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from phm.config.problems import Path
from phm.core.settings import Bytes, Celsius, Hertz, Percent, Seconds, Settings

_KINDS: tuple[tuple[Any, str], ...] = (
    (Seconds, "seconds"),
    (Bytes, "bytes"),
    (Hertz, "Hz"),
    (Percent, "percent"),
    (Celsius, "°C"),
)


def model_of(annotation: Any) -> type[BaseModel] | None:
    """The model in `Model`, `list[Model]`, `dict[str, Model]` or `Model | None`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next((model for part in get_args(annotation) if (model := model_of(part))), None)


def models_of(annotation: Any) -> tuple[type[BaseModel], ...]:
    """All models in an annotation: several for a list whose entries have a `type`."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return (annotation,)
    return tuple(model for part in get_args(annotation) for model in models_of(part))


def model_at(path: Path) -> type[BaseModel] | None:
    """The model whose keys are allowed at `path`; None where no model is."""
    model: type[BaseModel] | None = Settings
    inside = False
    by_type: dict[str, type[BaseModel]] = {}
    for part in path:
        if isinstance(part, int) or inside:
            inside = False
            continue
        if part in by_type:
            model, by_type = by_type[part], {}
            continue
        field = model.model_fields.get(part) if model else None
        model = model_of(field.annotation) if field else None
        by_type = _by_type(field) if field else {}
        inside = field is not None and get_origin(field.annotation) is dict
    return model


def without_types(path: Path) -> Path:
    """The path of a value in the file, from the path in an error of pydantic, which adds the `type` of a list entry after its index."""
    kept: list[str | int] = []
    for end, part in enumerate(path):
        field = field_at(path[: end - 1]) if end >= 2 and isinstance(path[end - 1], int) else None
        if field is None or part not in _by_type(field):
            kept.append(part)
    return tuple(kept)


def without_alternatives(path: Path) -> Path:
    """The path of a value of several possible types (`bool | float | str`), from that in an error of pydantic, which adds one of them."""
    model = model_at(path[:-2]) if len(path) > 1 else None
    field = model.model_fields.get(str(path[-2])) if model else None
    types = get_args(field.annotation) if field and get_origin(field.annotation) in (Union, UnionType) else ()
    return path[:-1] if sum(each is not NoneType for each in types) > 1 else path


def _by_type(field: FieldInfo) -> dict[str, type[BaseModel]]:
    """The models of a list by the `type` of an entry; empty for a list of one kind."""
    models = models_of(field.annotation)
    if len(models) < 2:
        return {}
    return {name: model for model in models for name in get_args(model.model_fields["type"].annotation)}


def field_at(path: Path) -> FieldInfo | None:
    """The field that a path ends at, or that holds the list or mapping in which it ends."""
    for end in range(len(path), 0, -1):
        model, last = model_at(path[: end - 1]), path[end - 1]
        if model and isinstance(last, str) and last in model.model_fields:
            return model.model_fields[last]
    return None


def metadata(field: FieldInfo) -> Iterator[Any]:
    """All constraints of a field, also those inside `X | None` and `list[X]`."""
    yield from _flat(field.metadata)
    yield from _inner(field.annotation)


def bound(field: FieldInfo, *names: str) -> float | None:
    """The value of the first constraint called one of `names` (`ge`, `gt`, `le`, `lt`)."""
    return next((getattr(entry, name) for entry in metadata(field) for name in names if hasattr(entry, name)), None)


def unit_of(field: FieldInfo) -> str:
    """`seconds`, `bytes`, `Hz`, `percent`, `°C`, or nothing for a plain number."""
    found = list(metadata(field))
    return next((unit for kind, unit in _KINDS if kind.__metadata__[0] in found), "")


def number(value: float) -> str:
    """250000000.0 -> 250000000, 0.1 -> 0.1."""
    return str(int(value)) if float(value).is_integer() else repr(value)


def range_of(field: FieldInfo) -> str:
    """`allowed is 1 to 3600 seconds`, `allowed is above 0 seconds`; empty when there is no limit."""
    low, above, high = bound(field, "ge"), bound(field, "gt"), bound(field, "le", "lt")
    unit = unit_of(field)
    if low is not None:
        words = f"{number(low)} to {number(high)}" if high is not None else f"{number(low)} or more"
    elif above is not None:
        words = f"above {number(above)}" + (f", at most {number(high)}" if high is not None else "")
    elif high is not None:
        words = f"at most {number(high)}"
    else:
        return ""
    return f"allowed is {words}{' ' + unit if unit else ''}"


def _flat(entries: Any) -> Iterator[Any]:
    for entry in entries:
        if isinstance(entry, FieldInfo):
            yield from _flat(entry.metadata)
        else:
            yield entry


def _inner(annotation: Any) -> Iterator[Any]:
    yield from _flat(getattr(annotation, "__metadata__", ()))
    for part in get_args(annotation):
        yield from _inner(part)
