"""The versions of ROS packages that `phm doctor` shows."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import pytest

from phm.probes.ros.installation import package_version

MANIFEST = '<package format="3">\n  <name>rmw_x</name>\n  <version compatibility="8.0.0">8.4.2</version>\n</package>\n'


def wheels(monkeypatch: pytest.MonkeyPatch, **versions: str) -> None:
    """The distributions that pip has installed."""
    found = [
        SimpleNamespace(metadata={"Name": name.replace("_", "-")}, version=version)
        for name, version in versions.items()
    ]
    monkeypatch.setattr(metadata, "distributions", lambda: found)


def test_the_version_is_that_of_the_wheel(monkeypatch: pytest.MonkeyPatch) -> None:
    """With or without the name of the distribution; not of another package whose name begins the same."""
    wheels(monkeypatch, ros_rmw_fastrtps_shared_cpp="1.0", ros_jazzy_rmw_fastrtps_cpp="8.4.3")
    assert package_version("rmw_fastrtps_cpp") == "8.4.3"


def test_without_a_wheel_it_is_that_of_the_manifest(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """As in an image of ROS: the first folder of AMENT_PREFIX_PATH that has the package."""
    wheels(monkeypatch)
    (tmp_path / "share" / "rmw_x").mkdir(parents=True)
    (tmp_path / "share" / "rmw_x" / "package.xml").write_text(MANIFEST)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/nowhere:{tmp_path}")
    assert package_version("rmw_x") == "8.4.2"
    assert package_version("rmw_y") == ""
