"""Files of the repository that must be valid on any machine: locks, scripts, and no names of the development machine."""

from __future__ import annotations

import json
import os
import re
import subprocess
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest
import yaml

from phm import __version__

ROOT = Path(__file__).resolve().parents[2]
LOCKS = sorted((ROOT / "scripts" / "locks").glob("*.lock"))
SCRIPTS = sorted(path for path in (ROOT / "scripts").glob("[a-z]*") if path.is_file() and not path.suffix)
PIN = re.compile(r"^([A-Za-z0-9._-]+)==(\S+)((?: ;[^\\]*)?) \\$")


def check_docs() -> ModuleType:
    spec = spec_from_file_location("check_docs", ROOT / "scripts" / "check_docs.py")
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def pins(lock: Path) -> set[tuple[str, str, str]]:
    """(name, version, marker) of each package of a lock."""
    found = (PIN.match(line) for line in lock.read_text("utf-8").splitlines())
    return {(match[1], match[2], match[3]) for match in found if match}


def test_no_file_names_a_registry_or_a_machine() -> None:
    """No file has the host of a package registry or a directory of one machine in it."""
    module = check_docs()
    assert list(module.machine_names(module.tracked())) == []


def test_a_broken_table_is_found(tmp_path: Path) -> None:
    """An empty line in a table makes text of the rows below it."""
    module = check_docs()
    vars(module)["ROOT"] = tmp_path
    page = tmp_path / "page.md"
    page.write_text(
        "| a | b |\n|---|---|\n| 1 | `x \\| y` |\n\n| 2 | 3 |\n\n| c |\n|---|\n| 4 | 5 |\n", encoding="utf-8"
    )
    assert [problem.partition(" ")[0] for problem in module.broken_tables([page])] == ["page.md:5:", "page.md:9:"]


@pytest.mark.parametrize("lock", LOCKS, ids=lambda path: path.stem)
def test_a_lock_has_only_pinned_packages_with_hashes(lock: Path) -> None:
    """Each line of a lock is a package at one version or a hash of one of its files; no address, no option."""
    package = None
    for line in lock.read_text("utf-8").splitlines():
        if line.startswith("    --hash=sha256:"):
            assert package, line
        else:
            package = PIN.match(line)
            assert package, line
    assert pins(lock)


@pytest.mark.parametrize("other", ["jazzy", "kilted"])
def test_the_locks_agree(other: str) -> None:
    """All locks have the same versions, so any two can be installed together; ROS is of one distribution."""
    apart = {"jazzy": {"ros", "app-jazzy"}, "kilted": {"kilted", "app-kilted"}}[other]
    versions: dict[tuple[str, str], str] = {}
    for lock in LOCKS:
        for name, version, marker in pins(lock) if lock.stem not in apart else ():
            assert versions.setdefault((name, marker), version) == version, (lock.name, name)


def test_the_locks_extend_each_other() -> None:
    """The larger one includes the smaller ones; the application's has one package that PHM's do not have."""
    names = {lock.stem: {name for name, _, _ in pins(lock)} for lock in LOCKS}
    assert names["runtime"] < names["ros"]
    assert names["runtime"] < names["test"] < names["dev"]
    assert names["test"] < names["kilted"]
    for distribution, own in (("jazzy", "ros"), ("kilted", "kilted")):
        assert names[f"app-{distribution}"] == {"ros-sensor-msgs"}
        assert not names[f"app-{distribution}"] & names[own]


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_scripts_are_executable_and_strict(script: Path) -> None:
    """Each script is executable, is valid Bash, and gets its strict mode from lib.sh."""
    assert os.access(script, os.X_OK)
    assert 'source "$(dirname -- "${BASH_SOURCE[0]}")/lib.sh"' in script.read_text("utf-8")
    subprocess.run(["bash", "-n", str(script)], check=True, timeout=120)


def test_the_bake_file_builds_stages_and_arguments_of_the_dockerfile() -> None:
    """Each target names a stage of docker/Dockerfile, for both platforms, and sets only arguments that it declares."""
    dockerfile = (ROOT / "docker" / "Dockerfile").read_text("utf-8")
    stages = set(re.findall(r"^FROM \S+ AS (\S+)$", dockerfile, re.MULTILINE))
    arguments = set(re.findall(r"^ARG (\w+)", dockerfile, re.MULTILINE))
    bake = json.loads((ROOT / "docker" / "docker-bake.json").read_text("utf-8"))
    common = bake["target"]["_published"]
    assert common["platforms"] == ["linux/amd64", "linux/arm64"]
    for name in bake["group"]["default"]["targets"]:
        target = bake["target"][name]
        assert target["inherits"] == ["_published"]
        assert target["target"] in stages
        assert {*common["args"], *target.get("args", {})} <= arguments
    assert bake["target"]["sidecar"]["args"] == {"EXTRAS": "${EXTRAS}"}
    used = set(re.findall(r"\$\{!?(\w+)\}", json.dumps(bake["target"])))
    assert used == set(bake["variable"])


@pytest.mark.parametrize(("variable", "attestation"), [("PROVENANCE", "provenance"), ("SBOM", "sbom")])
def test_the_bake_file_has_a_switch_for_each_attestation(variable: str, attestation: str) -> None:
    """On by default. The default is a boolean, so that bake takes the variable of the environment as one."""
    bake = json.loads((ROOT / "docker" / "docker-bake.json").read_text("utf-8"))
    assert bake["variable"][variable] == {"default": True}
    (entry,) = [one for one in bake["target"]["_published"]["attest"] if f"type={attestation}" in one]
    assert entry.endswith(f",disabled=${{!{variable}}}")
    page = (ROOT / "docs" / "development" / "release.md").read_text("utf-8")
    assert all(f"| `{name}` |" in page for name in bake["variable"])


def test_the_version_is_the_same_everywhere() -> None:
    """CITATION.cff and the newest section of the CHANGELOG name the version of the package."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))
    sections = re.findall(r"^## \[?([^\]\s]+)", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.MULTILINE)
    assert citation["version"] == __version__
    assert next(name for name in sections if name != "Unreleased") == __version__


def test_the_date_of_the_version_is_the_same_in_both_files() -> None:
    """CITATION.cff and the CHANGELOG."""
    changelog = (ROOT / "CHANGELOG.md").read_text("utf-8")
    (date,) = re.findall(rf"^## {re.escape(__version__)} - (\S+)$", changelog, re.MULTILINE)
    assert str(yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))["date-released"]) == date


@pytest.mark.parametrize(("tag", "good"), [(f"v{__version__}", True), ("v99.0.0", False), (__version__, False)])
def test_only_the_tag_of_the_version_is_published(tag: str, good: bool) -> None:
    """The workflow compares both before anything else."""
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "publish.yaml").read_text("utf-8"))
    step = workflow["jobs"]["test"]["steps"][1]
    assert step["env"] == {"TAG": "${{ github.ref_name }}"}
    done = subprocess.run(
        ["bash", "-ec", step["run"]], cwd=ROOT, env={**os.environ, "TAG": tag}, timeout=60, check=False
    )
    assert (done.returncode == 0) is good


@pytest.mark.parametrize("missing", ["", "pyproject.toml", "CITATION.cff", "docker/Dockerfile"])
def test_nothing_is_published_without_the_addresses_of_the_project(missing: str, tmp_path: Path) -> None:
    """The workflow looks for each of them before the tests run."""
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "publish.yaml").read_text("utf-8"))
    (step,) = [one for one in workflow["jobs"]["test"]["steps"] if "addresses" in one.get("name", "")]
    texts = {name: (ROOT / name).read_text("utf-8") for name in ("pyproject.toml", "CITATION.cff", "docker/Dockerfile")}
    texts["pyproject.toml"] = re.sub(r"\[project\.urls\]\n(?:.+\n)*", "", texts["pyproject.toml"])
    texts["CITATION.cff"] = re.sub(r"(?m)^repository-code:.*\n", "", texts["CITATION.cff"])
    texts["docker/Dockerfile"] += "# example.org\n"
    added = {
        "pyproject.toml": '\n[project.urls]\nHomepage = "https://phm.test"\n',
        "CITATION.cff": "repository-code: https://phm.test/phm\n",
    }
    (tmp_path / "docker").mkdir()
    for name, text in texts.items():
        good = text.replace("example.org", "phm.test") + added.get(name, "")
        (tmp_path / name).write_text(good if name != missing else text)
    done = subprocess.run(["bash", "-ec", step["run"]], cwd=tmp_path, capture_output=True, timeout=60, check=False)
    assert (done.returncode == 0) is (missing == "")
