"""Users install the wheel, so these tests install and run the wheel."""

from __future__ import annotations

import configparser
import hashlib
import importlib.util
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
from tests.fakes import runtime_wheels
from tests.fakes.engine import FakeEngine, container

ROOT = Path(__file__).resolve().parents[2]
PLUGIN = Path(__file__).resolve().parent / "plugin"
LIMIT_S = 300.0
VALIDATE_EACH = """
import sys
from phm.cli import main
for file in sys.argv[1:]:
    try:
        main(["validate", file])
    except SystemExit as end:
        assert not end.code, file
"""
"""`phm validate` of each file in one process: to start takes more CPU time than to validate."""
pytestmark = pytest.mark.packaging


def own_environment(**more: str) -> dict[str, str]:
    """Without the Python settings of this process; the first command leaves bytecode for those after it."""
    left_out = ("PYTHONPATH", "VIRTUAL_ENV", "PYTHONDONTWRITEBYTECODE")
    return {**{name: value for name, value in os.environ.items() if name not in left_out}, **more}


def run(*words: str | Path, cwd: Path, code: int = 0, **environment: str) -> str:
    """The standard output of a command that ends with `code`, in `own_environment`."""
    done = subprocess.run(
        [str(word) for word in words],
        cwd=cwd,
        env=own_environment(**environment),
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == code, f"{words} ended with {done.returncode}:\n{done.stdout}\n{done.stderr}"
    return done.stdout


def build(source: Path, target: Path) -> Path:
    """A wheel of `source`, built from a copy with the setuptools of this environment.

    By a call of what pip calls, too: the files are the same to the byte, for half of the CPU time. The images are built by `pip wheel`.
    """
    copy = target / "source"
    ignored = shutil.ignore_patterns(
        ".git", ".venv*", ".cache", "build", "dist", "*.egg-info", "__pycache__", ".*_cache", "sitl"
    )
    shutil.copytree(source, copy, ignore=ignored)
    code = "import sys; from setuptools import build_meta; build_meta.build_wheel(sys.argv[1])"
    run(sys.executable, "-c", code, target, cwd=copy)
    (wheel,) = target.glob("*.whl")
    return wheel


class Clean:
    """A new environment without pip, and the pip of this environment working in it: an own one takes 5 s of CPU."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.bin, self._tools = folder, folder / "bin", folder / "tools"
        run(sys.executable, "-m", "venv", "--without-pip", folder, cwd=folder)
        found = importlib.util.find_spec("pip")
        assert found is not None
        assert found.origin is not None
        self._tools.mkdir()  # with pip alone, so that nothing else of this environment can be imported
        (self._tools / "pip").symlink_to(Path(found.origin).parent)

    def pip(self, *words: str | Path) -> str:
        return run(self.bin / "python", "-m", "pip", *words, cwd=self.folder, PYTHONPATH=str(self._tools))

    def install(self, *words: str | Path) -> None:
        """Install without network; bytecode is made of what is imported alone, which is a small part of pymavlink and lxml."""
        self.pip("install", "--quiet", "--no-compile", "--no-index", *words)


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(ROOT, tmp_path_factory.mktemp("wheel"))


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory, wheel: Path) -> Iterator[Clean]:
    """A new environment with only the locked runtime packages and the wheel, for which the lock must be enough."""
    made = Clean(tmp_path_factory.mktemp("clean"))
    digest = hashlib.sha256(wheel.read_bytes()).hexdigest()
    ours = made.folder / "wheel.txt"  # pip wants a hash of each package if it wants one of any
    ours.write_text(f"{wheel.as_uri()} --hash=sha256:{digest}\n")
    wanted = ("--requirement", runtime_wheels.LOCK, "--requirement", ours)
    made.install("--find-links", runtime_wheels.folder(), "--require-hashes", *wanted)
    yield made
    shutil.rmtree(made.folder)


@pytest.fixture(scope="module")
def clean(environment: Clean) -> Path:
    """Its bin directory."""
    return environment.bin


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


def test_the_command_runs_from_the_wheel_alone(environment: Clean, clean: Path) -> None:
    """In an environment with the locked packages only, `phm --help` names the verbs and pip finds nothing missing."""
    text = run(clean / "phm", "--help", cwd=clean)
    assert {"run", "once", "validate", "checks", "status"} <= set(text.split())
    environment.pip("check")


def test_a_folder_is_made_from_the_wheel_alone(clean: Path, tmp_path: Path) -> None:
    """The templates of `phm init` are in the wheel, and what it writes is valid."""
    with FakeEngine(tmp_path / "engine.sock") as fake:
        fake.containers["app"] = container("app", networks=["swarm"])
        run(clean / "phm", "init", "agent", "--yes", "--socket", fake.url, cwd=tmp_path)
    assert "1 container," in run(clean / "phm", "validate", "agent/phm.yaml", cwd=tmp_path)
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
    files = [str(folder / name) for name in ("phm.yaml", *examples)]
    assert run(clean / "python", "-c", VALIDATE_EACH, *files, cwd=tmp_path).count(": valid, agent ") == len(files)


@pytest.mark.long
@pytest.mark.xdist_group("packaging/test_wheel.py")  # else a second worker would make wheel and environment again
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


def test_a_third_party_check_is_found_beside_ours(environment: Clean, tmp_path: Path) -> None:
    """An installed package with an entry point is found, and one that cannot be loaded has a reason."""
    target = tmp_path / "installed"  # as into an image; the environment stays as it is for the other tests
    environment.install("--no-deps", "--target", target, build(PLUGIN, tmp_path))
    output = run(environment.bin / "phm", "checks", "--json", cwd=tmp_path, code=1, PYTHONPATH=str(target))
    entries = {entry["name"]: entry for entry in json.loads(output)}
    assert "phm-battery 1.2.3" in json.dumps(entries["battery"])
    assert not entries["battery"].get("problem")
    assert "phm_battery.missing" in entries["broken"]["problem"]
    assert "companion" in entries
