"""Users install the wheel, so these tests install and run the wheel."""

from __future__ import annotations

import configparser
import json
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.cli import test_demo
from tests.fakes.engine import FakeEngine, container

ROOT = Path(__file__).resolve().parents[2]
PLUGIN = Path(__file__).resolve().parent / "plugin"
LOCKS = ROOT / "scripts" / "locks"
LIMIT_S = 300.0
pytestmark = pytest.mark.packaging


def own_environment() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}


def run(*words: str | Path, cwd: Path) -> str:
    """The standard output of a command that must succeed, without the Python settings of this process."""
    done = subprocess.run(
        [str(word) for word in words],
        cwd=cwd,
        env=own_environment(),
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, f"{words} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}"
    return done.stdout


def build(source: Path, target: Path) -> Path:
    """A wheel of `source`, built from a copy with the setuptools of this environment."""
    copy = target / "source"
    ignored = shutil.ignore_patterns(
        ".git", ".venv*", ".cache", "build", "dist", "*.egg-info", "__pycache__", ".*_cache", "sitl"
    )
    shutil.copytree(source, copy, ignore=ignored)
    run(
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "--quiet",
        "--no-index",
        "--no-deps",
        "--no-build-isolation",
        "--wheel-dir",
        target,
        copy,
        cwd=target,
    )
    (wheel,) = target.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(ROOT, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory, wheel: Path) -> Iterator[Path]:
    """The bin directory of a new environment with only the locked runtime packages and the wheel."""
    folder = tmp_path_factory.mktemp("clean")
    run(sys.executable, "-m", "venv", folder, cwd=folder)
    pip = (folder / "bin" / "python", "-m", "pip", "install", "--quiet")
    run(*pip, "--require-hashes", "--requirement", LOCKS / "runtime.lock", cwd=folder)
    run(*pip, "--no-index", "--no-deps", wheel, cwd=folder)
    yield folder / "bin"
    shutil.rmtree(folder)


def test_the_wheel_has_only_the_two_packages(wheel: Path) -> None:
    """The wheel has phm and phm_checks with their type markers and licence, and no tests, simulation or scripts."""
    names = zipfile.ZipFile(wheel).namelist()
    (metadata,) = {name.partition("/")[0] for name in names if ".dist-info/" in name}
    assert {name.partition("/")[0] for name in names} == {"phm", "phm_checks", metadata}
    assert {"phm/py.typed", "phm_checks/py.typed", f"{metadata}/licenses/LICENSE"} <= set(names)
    sources = {str(path.relative_to(ROOT)) for path in (ROOT / "phm").rglob("*.py")}
    assert sources == {name for name in names if name.startswith("phm/") and name.endswith(".py")}


def test_the_wheel_brings_one_command(wheel: Path) -> None:
    """`phm`; pymavlink and pyserial bring others, which docs/guides/get-started.md says."""
    archive = zipfile.ZipFile(wheel)
    assert not [name for name in archive.namelist() if ".data/" in name]
    (name,) = [name for name in archive.namelist() if name.endswith(".dist-info/entry_points.txt")]
    points = configparser.ConfigParser()
    points.read_string(archive.read(name).decode())
    assert dict(points["console_scripts"]) == {"phm": "phm.cli:main"}
    assert "gui_scripts" not in points


def test_the_command_runs_from_the_wheel_alone(clean: Path) -> None:
    """In an environment with the locked packages only, `phm --help` names the verbs and pip finds nothing missing."""
    text = run(clean / "phm", "--help", cwd=clean)
    assert {"run", "once", "validate", "checks", "status"} <= set(text.split())
    run(clean / "python", "-m", "pip", "check", cwd=clean)


def test_a_folder_is_made_from_the_wheel_alone(clean: Path, tmp_path: Path) -> None:
    """The templates of `phm init` are in the wheel, and what it writes is valid."""
    with FakeEngine(tmp_path / "engine.sock") as fake:
        fake.containers["app"] = container("app", networks=["swarm"])
        run(clean / "phm", "init", "agent", "--yes", "--socket", fake.url, cwd=tmp_path)
    assert "1 containers" in run(clean / "phm", "validate", "agent/phm.yaml", cwd=tmp_path)
    assert (tmp_path / "agent" / "compose.yaml").exists()


def test_schema_and_examples_are_in_the_wheel(clean: Path, tmp_path: Path) -> None:
    """The files of config/ that documents name, each with the same content; every example is valid."""
    folder = Path(run(clean / "phm", "validate", "--examples", cwd=tmp_path).strip())
    assert folder.is_relative_to(clean.parent)
    found = {str(path.relative_to(folder)): path.read_text("utf-8") for path in folder.rglob("*") if path.is_file()}
    fixed = {"phm.schema.json", "phm.yaml", "fastdds.xml", "systemd/phm.service"}
    examples = {f"examples/{path.name}" for path in (ROOT / "config" / "examples").glob("*.yaml")}
    assert found == {name: (ROOT / "config" / name).read_text("utf-8") for name in fixed | examples}
    assert run(clean / "phm", "validate", "--schema", cwd=tmp_path) == found["phm.schema.json"]
    for name in ("phm.yaml", *examples):
        assert ": valid, agent " in run(clean / "phm", "validate", folder / name, cwd=tmp_path)


@pytest.mark.long
def test_the_demo_runs_from_the_wheel_alone(clean: Path, tmp_path: Path) -> None:
    """`phm demo --for` shows its three agents in a clean environment."""
    demo = [str(clean / "phm"), "demo", *test_demo.options(test_demo.free_base(), test_demo.LIMIT_S)]
    assert test_demo.end_after_discovery(demo, cwd=tmp_path, env=own_environment()) == 0


def test_the_page_is_in_the_wheel(clean: Path) -> None:
    """With its scripts, its styles and the plotting library with its licence."""
    code = "from phm.gcs import web; import pathlib; root = pathlib.Path(web.__file__).parent / 'static'; print(*root.rglob('*.*'), sep='\\n')"
    names = {Path(line).name for line in run(clean / "python", "-c", code, cwd=clean).splitlines()}
    assert {"index.html", "main.js", "page.css", "icon.svg", "uPlot.esm.js", "uPlot.LICENSE.txt"} <= names


def test_without_rclpy_everything_still_loads(clean: Path) -> None:
    """No part of PHM needs ROS to be imported: all checks are listed, none with a problem."""
    entries = json.loads(run(clean / "phm", "checks", "--json", cwd=clean))
    assert {entry["name"] for entry in entries} >= {
        "companion",
        "container",
        "files",
        "network",
        "nodes",
        "topics",
        "rates",
    }
    assert [entry for entry in entries if entry.get("problem")] == []


def test_a_third_party_check_is_found_beside_ours(clean: Path, tmp_path: Path) -> None:
    """An installed package with an entry point is found, and one that cannot be loaded has a reason."""
    plugin = build(PLUGIN, tmp_path)
    pip = (clean / "python", "-m", "pip")
    run(*pip, "install", "--quiet", "--no-index", "--no-deps", plugin, cwd=tmp_path)
    try:
        output = subprocess.run(
            [clean / "phm", "checks", "--json"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=LIMIT_S,
            check=False,
        ).stdout
    finally:
        run(*pip, "uninstall", "--quiet", "--yes", "phm-battery", cwd=tmp_path)
    entries = {entry["name"]: entry for entry in json.loads(output)}
    assert "phm-battery 1.2.3" in json.dumps(entries["battery"])
    assert not entries["battery"].get("problem")
    assert "phm_battery.missing" in entries["broken"]["problem"]
    assert "companion" in entries
