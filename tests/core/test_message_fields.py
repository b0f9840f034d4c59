"""Fields of installed message types, read without executing a package."""

from __future__ import annotations

from pathlib import Path

import pytest

from phm.core.message_fields import (
    UnknownField,
    demand_counter,
    demand_value,
    field_type,
    fields_of,
    has_header,
    has_other_stamps,
)

MODULE = """
raise RuntimeError("executed")

class {name}(metaclass=Metaclass_{name}):
    _fields_and_field_types = {{
{fields}
    }}

    def __init__(self): ...
"""
TYPES = {
    "GPSFix": {"header": "std_msgs/Header", "status": "phm_test_msgs/Status", "err": "double", "name": "string"},
    "Status": {
        "seq": "uint32",
        "sats": "sequence<int32, 8>",
        "cov": "double[9]",
        "all": "sequence<phm_test_msgs/Status>",
        "ok": "boolean",
        "level": "octet",
        "other": "absent_msgs/Thing",
    },
    "Empty": {},
    "Time": {"sec": "int32", "nanosec": "uint32"},
    "Path": {"header": "std_msgs/Header", "fixes": "sequence<phm_test_msgs/Stamped>"},
    "Stamped": {"x": "double", "stamp": "builtin_interfaces/Time"},
    "Began": {"began": "builtin_interfaces/Time", "x": "double"},
    "Reference": {"header": "std_msgs/Header", "time_ref": "builtin_interfaces/Time", "from": "phm_test_msgs/Began"},
    "Px4": {"timestamp": "uint64", "x": "float"},
    "OfPx4": {"all": "phm_test_msgs/Px4[3]"},
}
FILES = {"GPSFix": "_gps_fix.py", "OfPx4": "_of_px4.py"}
FIX, STATUS = "phm_test_msgs/msg/GPSFix", "phm_test_msgs/msg/Status"


@pytest.fixture(autouse=True)
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A package as rosidl generates it, whose modules must not be executed."""
    folder = tmp_path / "phm_test_msgs" / "msg"
    folder.mkdir(parents=True)
    (tmp_path / "phm_test_msgs" / "__init__.py").write_text("raise RuntimeError('executed')")
    for name, fields in TYPES.items():
        lines = "\n".join(f"        {key!r}: {kind!r}," for key, kind in fields.items())
        (folder / FILES.get(name, f"_{name.lower()}.py")).write_text(MODULE.format(name=name, fields=lines))
    monkeypatch.syspath_prepend(str(tmp_path))
    return folder


def test_fields_are_read_in_order() -> None:
    """Of the full and of the short name of a type, and of one whose name has an abbreviation."""
    assert fields_of(FIX) == TYPES["GPSFix"] == fields_of("phm_test_msgs/GPSFix")
    assert list(fields_of(STATUS) or ()) == list(TYPES["Status"])
    assert fields_of("phm_test_msgs/msg/Empty") == {}


@pytest.mark.parametrize(
    "name", ["absent_msgs/msg/X", "phm_test_msgs/msg/Absent", "", "os", "../x/msg/Y", "double", "json/msg/JSON"]
)
def test_unknown_types_have_no_fields(name: str) -> None:
    """Not installed, not a type, or a package without messages."""
    assert fields_of(name) is None and has_header(name) is None


@pytest.mark.parametrize(
    "text",
    [
        "",
        "\xff",
        "    _fields_and_field_types = {\n        1: 2,\n    }\n",
        "    _fields_and_field_types = {\n  x(\n    }\n",
    ],
)
def test_a_damaged_module_has_no_fields(package: Path, text: str) -> None:
    """A generated Python module that cannot be read gives no fields, and no error."""
    (package / "_status.py").write_text(text, encoding="latin-1")
    assert fields_of(STATUS) is None


def test_a_header_must_come_first() -> None:
    """A message has a usable stamp only if its first field is a std_msgs/Header."""
    assert (has_header(FIX), has_header(STATUS), has_header("phm_test_msgs/msg/Empty")) == (True, False, False)


@pytest.mark.parametrize(
    ("stamped", "names"),
    [(True, "Path Stamped Began Px4"), (False, "GPSFix Status Empty Time Reference OfPx4"), (None, "Absent")],
)
def test_stamps_outside_of_the_header_are_known(stamped: bool | None, names: str) -> None:
    """Of a message in an array, one that comes first, PX4's number. A time of another name, or a number further inside, is none."""
    assert {has_other_stamps(f"phm_test_msgs/msg/{name}") for name in names.split()} == {stamped}


def test_a_field_may_be_nested() -> None:
    """Unknown behind a type that is not installed."""
    assert field_type(FIX, "status.seq") == "uint32" and field_type(FIX, "err") == "double"
    assert field_type(FIX, "status.other.x") is None and field_type("absent_msgs/msg/X", "y") is None


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("er", "has no field 'er'; it has header, status, err, name"),
        ("status.sequence", "phm_test_msgs/Status has no field 'sequence'"),
        ("err.x", "has no field 'x': it is of type double"),
        ("status.all.seq", "'seq' is a field of the elements of an array"),
    ],
)
def test_an_unknown_field_is_named_with_those_that_exist(name: str, words: str) -> None:
    """The type at each level of the path, too."""
    with pytest.raises(UnknownField) as caught:
        field_type(FIX, name)
    assert words in str(caught.value)


def test_ranges_are_for_numbers_and_arrays_of_numbers() -> None:
    """Also booleans; not texts or messages."""
    for name in ("err", "status.seq", "status.sats", "status.cov", "status.ok", "status.other.x"):
        demand_value(FIX, name, number=True)
    for name in ("name", "status", "status.all", "status.level"):
        with pytest.raises(UnknownField, match="not a number"):
            demand_value(FIX, name, number=True)


def test_a_counter_is_a_single_number() -> None:
    """Its size shows where it wraps; a floating-point number does not wrap."""
    assert (demand_counter(FIX, "status.seq"), demand_counter(FIX, "err")) == (32, None)
    assert demand_counter("absent_msgs/msg/X", "seq") is None
    for name in ("name", "status.sats", "status.ok"):
        with pytest.raises(UnknownField, match="not an integer"):
            demand_counter(FIX, name)


def test_an_element_of_an_array_is_named_by_its_index() -> None:
    """Also one on the way to a field of a message in it."""
    assert [field_type(STATUS, name) for name in ("sats[7]", "cov[8]", "all[0].all[3].seq")] == [
        "int32",
        "double",
        "uint32",
    ]


@pytest.mark.parametrize(
    ("name", "number", "words"),
    [
        ("cov[9]", False, "cov has 9 elements: the highest index is 8"),
        ("seq[0]", False, "seq is of type uint32, not an array: remove the index"),
        ("all", False, "is of type sequence<phm_test_msgs/Status>, not a number or a text"),
        ("all[0]", False, "is of type phm_test_msgs/Status, not a number or a text"),
        ("level", True, "is of type octet, not a number"),
    ],
)
def test_a_value_is_a_number_or_a_text(name: str, number: bool, words: str) -> None:
    """A text only where no number is needed."""
    for good in ("seq", "cov", "cov[0]", "ok", "other.x"):
        demand_value(STATUS, good, number=number)
    demand_value(FIX, "name")
    with pytest.raises(UnknownField, match="is of type string, not a number"):
        demand_value(FIX, "name", number=True)
    with pytest.raises(UnknownField) as caught:
        demand_value(STATUS, name, number=number)
    assert words in str(caught.value)
