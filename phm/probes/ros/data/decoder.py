"""Decodes messages of one type for their configured fields. Raises only `Undecodable`, whatever a message contains."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

from phm.core.message_fields import UnknownField, demand_counter, demand_value, has_other_stamps, stamps
from phm.facts.ros import FieldFact
from phm.probes.ros.message_types import UnknownType, load_decodable
from phm.probes.ros.protocol import WantedData

MAX_DECODED = 200_000
"""Longest message in bytes that is decoded; Python needs about 10 ms for one of numbers, up to 100 ms for one of very small messages."""
MAX_TEXT, MAX_FIELD_TEXT = 40, 200
_BEFORE = 12
"""Bytes of encapsulation and stamp, which `phm.probes.ros.data.raw_message.digest` leaves out."""


class Undecodable(ValueError):
    """A message, or all of this type, cannot be decoded; the text says why."""


class NoElement(ValueError):
    """An array of a message is shorter than an index."""


class Decoded(NamedTuple):
    """What one message contains: the counter, the fields outside of their range, the content to compare, in which the counter is 0,
    and the fields whose value is reported. problem: a field with a range that it lacks, else empty."""

    counter: float | None
    outside: Mapping[str, str]
    content: bytes
    fields: tuple[FieldFact, ...] = ()
    problem: str = ""


class Decoder:
    """For one type. problem: why a configured part cannot be examined for any message of it; empty if all can.

    unreadable: the same for fields whose value is reported, so that a wrong one does not hide what else is examined.
    """

    def __init__(self, wanted: WantedData, type_name: str) -> None:
        self._wanted = wanted
        self._message: Any = None
        self._deserialize: Any = None
        self.counter_bits: int | None = None
        self.problem = ""
        self.unreadable: tuple[FieldFact, ...] = ()
        self._fields: tuple[str, ...] = ()
        self.stamped = has_other_stamps(type_name, class_fields) if wanted.frozen_s is not None else False
        """Whether `frozen` needs messages to be decoded, for their stamps outside of a header; None: the type is unknown."""
        if self.stamped or wanted.counter or wanted.ranges or wanted.fields:
            try:
                self._prepare(type_name)
            except (UnknownType, UnknownField) as error:
                self._message = None
                self.problem = str(error) if wanted.counter or wanted.ranges else ""
                self.unreadable = tuple(FieldFact(name, problem=str(error)) for name in wanted.fields)

    def _prepare(self, type_name: str) -> None:
        from rclpy.serialization import deserialize_message
        from rclpy.type_support import check_for_type_support

        found = load_decodable(type_name)
        check_for_type_support(found)
        for limits in self._wanted.ranges:
            demand_value(type_name, limits.field, class_fields, number=True)
        if self._wanted.counter:
            self.counter_bits = demand_counter(type_name, self._wanted.counter, class_fields)
        for name in self._wanted.fields:
            try:
                demand_value(type_name, name, class_fields)
                self._fields += (name,)
            except UnknownField as error:
                self.unreadable += (FieldFact(name, problem=str(error)),)
        self._message, self._deserialize = found, deserialize_message

    @property
    def usable(self) -> bool:
        """Whether there is anything to decode."""
        return self._message is not None

    def read(self, data: bytes) -> Decoded:
        """The values of a message. Raises Undecodable."""
        if len(data) > MAX_DECODED:
            raise Undecodable(
                f"messages of more than {MAX_DECODED // 1000} kB are not decoded, this one has {len(data)} bytes"
            )
        try:
            message = self._deserialize(data, self._message)
            outside, problem = self._outside(message)
            fields = tuple(_field(message, name) for name in self._fields)
            counter = _value(message, self._wanted.counter) if self._wanted.counter else math.nan
            if self._wanted.frozen_s is not None:
                if self._wanted.counter:
                    owner, _, name = self._wanted.counter.rpartition(".")
                    setattr(_value(message, owner) if owner else message, name, type(counter)(0))
                # A message with nothing but a stamp is compared unchanged.
                content = b"".join(_content(message, top=True))
                data = bytes(_BEFORE) + content if content else data
        except Exception as error:  # exceptions of rclpy and pybind: what was sent is not such a message
            raise Undecodable(f"a message cannot be decoded: {str(error)[:200]}") from error
        return Decoded(counter if math.isfinite(counter) else None, outside, data, (*fields, *self.unreadable), problem)

    def _outside(self, message: Any) -> tuple[dict[str, str], str]:
        """The fields outside of their range, and why one cannot be compared."""
        found, problem = {}, ""
        for limits in self._wanted.ranges:
            try:
                text = _outside(_value(message, limits.field), limits.low, limits.high)
            except NoElement as error:
                problem = str(error)
                continue
            if text:
                found[limits.field] = text
        return found, problem


def _content(value: Any, *, top: bool = False) -> Iterator[bytes]:
    """The values of all fields but stamps. Not the serialized message: between fields that are aligned it has bytes that nothing
    writes, which differ between equal messages."""
    if hasattr(value, "get_fields_and_field_types"):
        for name in _names(value.__class__, top):
            yield from _content(getattr(value, name))
    elif hasattr(value, "tobytes"):
        yield value.tobytes()
    elif isinstance(value, list | tuple):
        yield b"%d," % len(value)
        for inner in value:
            yield from _content(inner)
    else:
        yield f"{value!r},".encode(errors="surrogatepass")


@lru_cache(maxsize=256)
def _names(message: Any, top: bool) -> tuple[str, ...]:
    """Names of the fields of a class that are content."""
    fields = message.get_fields_and_field_types()
    only_when = stamps(fields, top=top)
    return tuple(name for name in fields if name not in only_when)


def class_fields(type_name: str) -> Mapping[str, str] | None:
    """Implements `FieldsOf` with the classes that this process can load; None: not installed, and not in `ros.installs`."""
    package, _, short = type_name.rpartition("/")
    try:
        found = load_decodable(f"{package.removesuffix('/msg')}/msg/{short}")
    except UnknownType:
        return None
    fields: Mapping[str, str] = found.get_fields_and_field_types()
    return fields


def _value(message: Any, name: str) -> Any:
    """The value of `a.b` or `a[0].b`. Raises NoElement."""
    value = message
    for step in name.split("."):
        part, bracket, index = step.partition("[")
        value = getattr(value, part)
        if bracket:
            place = int(index.rstrip("]"))
            if place >= len(value):
                raise NoElement(f"{part} has {len(value)} elements in the newest message, none with index {place}")
            value = value[place]
    return value


def _field(message: Any, name: str) -> FieldFact:
    try:
        value = _value(message, name)
    except NoElement as error:
        return FieldFact(name, problem=str(error))
    if isinstance(value, str):
        return FieldFact(name, text=value[:MAX_FIELD_TEXT])
    values: Sequence[Any] = value if hasattr(value, "__len__") else (value,)
    values = values.tolist() if hasattr(values, "tolist") else values
    numbers = [number for number in values if number == number]  # false for NaN
    low, high = (min(numbers), max(numbers)) if numbers else (None, None)
    return FieldFact(name, _finite(low), _finite(high), len(numbers) < len(values))


def _finite(number: float | None) -> float | None:
    """The pipe to the daemon has no infinity."""
    return None if number is None else max(-sys.float_info.max, min(sys.float_info.max, float(number)))


def _outside(value: Any, low: float | None, high: float | None) -> str:
    """The number, or the first element, that is not within the limits, as text; NaN never is. Empty: all are."""
    least, most = -math.inf if low is None else low, math.inf if high is None else high
    values: Sequence[Any] = value if hasattr(value, "__len__") else (value,)
    # Elements of numpy arrays would be compared much more slowly.
    values = values.tolist() if hasattr(values, "tolist") else values
    return next((f"{found:.6g}"[:MAX_TEXT] for found in values if not least <= found <= most), "")
