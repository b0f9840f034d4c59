"""The class of a message type: installed, created from its name, or from the application's install folder; else a
reason.
"""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from phm.probes.ros import message_types, opaque_types
from phm.probes.ros.message_types import UnknownType, load_type
from phm.probes.ros.opaque_types import OpaqueTypes, TypeUnavailable
from phm.probes.ros.protocol import INSTALLS
from tests.fakes import app_messages
from tests.fakes.app_messages import OTHER_DISTRIBUTION, OWN_DISTRIBUTION, OWN_PYTHON

# The parser in ROS's generated messages imports a module that Python has deprecated.
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")

NAMES = (
    "no_such_msgs/Thing",
    "",
    "x",
    "/msg/A",
    "..//",
    "os/path",
    "a/msg/B/c",
    "a/msg/B\n",
    "A/msg/b",
    f"a/msg/{'B' * 101}",
)


@pytest.fixture
def by_name_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on unknown middleware: classes cannot be created from a name."""
    monkeypatch.setattr(opaque_types, "KNOWN", {})
    monkeypatch.setattr(message_types, "_any_types", OpaqueTypes())


@pytest.mark.parametrize("name", NAMES)
def test_an_invalid_type_name_is_reported(name: str) -> None:
    """Names come from the network: nothing is imported for them, and they result in an error message."""
    with pytest.raises(UnknownType, match=r"^type unknown: .* is not the name of a ROS type$"):
        load_type(name)


def test_an_installed_type_is_used_unchanged() -> None:
    """A type installed beside PHM has precedence."""
    from std_msgs.msg import String

    assert load_type("std_msgs/msg/String") is String


@pytest.mark.parametrize(
    "name", ["sensor_msgs/msg/Imu", "std_msgs/msg/NoSuchType", "nav2_msgs/action/Spin_FeedbackMessage"]
)
def test_a_missing_type_is_created_from_its_name(name: str) -> None:
    """Without the package a class is created, once per type."""
    made = load_type(name)
    assert made.__name__ == "AnyType"
    assert load_type(name) is made


def test_an_unavailable_type_is_reported_with_every_reason(
    by_name_unknown: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not installed, not by its name, not mounted: one message with every reason and what to do."""
    monkeypatch.delenv(INSTALLS, raising=False)
    with pytest.raises(UnknownType) as caught:
        load_type("sensor_msgs/msg/Imu")
    text = str(caught.value)
    assert text.startswith("type unknown: sensor_msgs/msg/Imu is not installed beside PHM; ")
    assert "it cannot be read by its name alone, as this version of Fast DDS is not known (fast" in text
    assert "mount the application's install/" in text


@pytest.mark.parametrize(
    ("lines", "variables", "reason"),
    [
        (["/usr/lib/libfastrtps.so.2.6.9"], {}, "not known (fastrtps 2.6)"),
        (["/usr/lib/libfastdds.so.3.9"], {}, "not known (fastdds 3.9)"),
        ([], {}, "not known (none)"),
        (["/a/libfastrtps.so.2.14.5", "/b/libfastdds.so.3.2.3"], {}, "not known (fastdds 3.2, fastrtps 2.14)"),
        (["/usr/lib/libfastrtps.so.2.14.5"], {"ROS_DISTRO": "rolling"}, "the distribution is rolling"),
    ],
)
def test_unknown_middleware_is_not_modified(
    monkeypatch: pytest.MonkeyPatch, lines: list[str], variables: dict[str, str], reason: str
) -> None:
    """By the loaded library, and by the distribution where the environment names one."""
    monkeypatch.setattr(opaque_types, "_maps", lambda: [f"7f00-7f01 r-xp 0 0:0 1 {line}" for line in lines])
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    with pytest.raises(TypeUnavailable) as caught:
        OpaqueTypes().make("a", "msg", "B")
    assert reason in str(caught.value)


def test_other_middleware_is_not_modified(monkeypatch: pytest.MonkeyPatch) -> None:
    """The memory layout is that of Fast DDS; with another middleware the effect is unknown."""
    monkeypatch.setattr("rclpy.utilities.get_rmw_implementation_identifier", lambda: "rmw_cyclonedds_cpp")
    with pytest.raises(TypeUnavailable, match="the middleware is rmw_cyclonedds_cpp, not rmw_fastrtps_cpp"):
        OpaqueTypes().make("a", "msg", "B")


@pytest.mark.parametrize("offset", [-(2**20) * 2**30, -8, 8, 16, 2**13])
def test_an_unknown_memory_layout_is_reported_and_not_followed(monkeypatch: pytest.MonkeyPatch, offset: int) -> None:
    """Wrong or invalid pointers result in an error message: following them would terminate this process."""
    real = opaque_types._peek

    def shifted(address: int, size: int) -> bytes:
        return real(address + offset, size)

    monkeypatch.setattr(opaque_types, "_peek", shifted)
    with pytest.raises(TypeUnavailable, match="has an unknown layout"):
        OpaqueTypes().make("a", "msg", "B")


def test_the_copied_names_must_be_where_they_are_expected(monkeypatch: pytest.MonkeyPatch) -> None:
    """The original's own names, found where they are to be changed, prove that the layout is the known one."""
    monkeypatch.setattr(opaque_types, "_BASE", ("rcl_interfaces", "msg", "Log"))
    with pytest.raises(TypeUnavailable, match="unexpected offset of its names"):
        OpaqueTypes().make("a", "msg", "B")


def test_functions_must_be_code(monkeypatch: pytest.MonkeyPatch) -> None:
    """The addresses of functions must point to code."""
    monkeypatch.setattr(opaque_types, "_code", lambda: [(0, 1)])
    with pytest.raises(TypeUnavailable, match="unexpected offset of its functions"):
        OpaqueTypes().make("a", "msg", "B")


def test_the_number_of_created_types_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    """Created types are never freed, and names come from outside."""
    monkeypatch.setattr(opaque_types, "MAX_TYPES", 2)
    types = OpaqueTypes()
    for name in ("A", "B", "A"):
        types.make("a", "msg", name)
    with pytest.raises(TypeUnavailable, match="more than 2 types"):
        types.make("a", "msg", "C")


@pytest.fixture(scope="module")
def installs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Install folders of applications, by their special property."""
    folder = tmp_path_factory.mktemp("installs")
    merged = app_messages.install(OWN_DISTRIBUTION)
    old = folder / "old" / "lib" / "python3.8"
    shutil.copytree(merged / "lib" / f"python{OWN_PYTHON}" / "site-packages", old / "site-packages")
    poor = folder / "poor"
    shutil.copytree(merged, poor)
    shutil.move(poor / "lib" / "libsensor_msgs__rosidl_generator_c.so", poor / "lib" / "elsewhere")
    empty = folder / "empty"
    empty.mkdir()
    return {
        "merged": merged,
        "isolated": app_messages.isolated(merged, folder / "isolated"),
        "empty": empty,
        "old": folder / "old",
        "poor": poor,
        "other": app_messages.install(OTHER_DISTRIBUTION),
        "none": folder / "not" / "there",
    }


def loaded(installs: list[Path], *names: str) -> str:
    """What a separate process reports about types that it can only find in these folders."""
    code = (
        "import sys\nfrom phm.probes.ros import opaque_types, message_types\n"
        "opaque_types.KNOWN.clear()\n"
        "for name in sys.argv[1:]:\n"
        " try: kind = message_types.load_type(name)\n"
        " except message_types.UnknownType as error: print(error)\n"
        " else: print(kind.__module__, kind.__class__._TYPE_SUPPORT is not None)\n"
    )
    environ = {**os.environ, INSTALLS: os.pathsep.join(map(str, installs))}
    done = subprocess.run(
        [sys.executable, "-c", code, *names], env=environ, capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.mark.parametrize("names", [("merged",), ("isolated",), ("none", "empty", "isolated")])
def test_a_mounted_install_is_the_last_resort(installs: dict[str, Path], names: tuple[str, ...]) -> None:
    """Merged or isolated, the application's folder provides the type with its support, and no variable needs to be set."""
    assert loaded([installs[name] for name in names], "sensor_msgs/msg/Imu") == "sensor_msgs.msg._imu True"


def test_each_package_of_an_install_is_loaded_with_its_dependencies(installs: dict[str, Path], tmp_path: Path) -> None:
    """A package that Python finds because another one of the same folder was loaded before is still loaded completely."""
    second = tmp_path / "second_msgs" / "lib" / f"python{OWN_PYTHON}" / "site-packages" / "second_msgs"
    (second / "msg").mkdir(parents=True)
    (second / "__init__.py").touch()
    (second / "msg" / "__init__.py").write_text("class Thing: pass\n")
    shutil.copytree(installs["isolated"], tmp_path, dirs_exist_ok=True)
    said = loaded([tmp_path], "sensor_msgs/msg/Imu", "second_msgs/msg/Thing")
    assert said.startswith(
        "sensor_msgs.msg._imu True\ntype unknown: second_msgs/msg/Thing is not installed beside PHM; "
    )
    assert "ros.installs has it, but it cannot be loaded" in said


@pytest.mark.parametrize(
    ("name", "kind", "reason"),
    [
        ("empty", "sensor_msgs/msg/Imu", "none of the folders of ros.installs has sensor_msgs"),
        ("none", "sensor_msgs/msg/Imu", "none of the folders of ros.installs has sensor_msgs"),
        ("old", "sensor_msgs/msg/Imu", f"has it for Python 3.8, while PHM runs Python {OWN_PYTHON}"),
        ("merged", "sensor_msgs/msg/NoSuchType", "has sensor_msgs, but without this type"),
        ("poor", "sensor_msgs/msg/Imu", "needs libsensor_msgs__rosidl_generator_c.so, which PHM's ROS lacks"),
    ],
)
def test_an_incompatible_mounted_install_is_reported(
    installs: dict[str, Path], name: str, kind: str, reason: str
) -> None:
    """Each possible problem has its message, and none is a crash."""
    assert reason in loaded([installs[name]], kind)


def test_a_mounted_install_of_another_distribution_is_harmless(installs: dict[str, Path]) -> None:
    """It is reported, or its messages work; the process continues."""
    said = loaded([installs["other"]], "sensor_msgs/msg/Imu")
    assert said == "sensor_msgs.msg._imu True" or "cannot be loaded" in said


def test_this_environment_has_no_such_package() -> None:
    """The type that these tests consider missing is not installed."""
    assert importlib.util.find_spec("sensor_msgs") is None
