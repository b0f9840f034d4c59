"""The command `phm validate` and the loading that it shares with `phm run`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from phm import api
from phm.checking import registry
from phm.cli.validate import command
from phm.config import ConfigError
from phm.runtime import configuration
from phm.runtime.configuration import read

GOOD = "containers: [{name: app}]\nros: {nodes: [{name: /a/one}]}\n"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A valid configuration that a test may change."""
    path = tmp_path / "phm.yaml"
    path.write_text(GOOD)
    return path


def test_a_valid_file_is_summarized_in_one_line(file: Path) -> None:
    """Exit code 0 and one line with the number of units."""
    done = CliRunner().invoke(command, [str(file)], env={"PHM_INTERVAL": "5s"})
    assert done.exit_code == 0
    assert done.stdout.startswith(f"{file}: valid, agent agent_1 (id 1), every 5 s: ")
    assert ", 1 node, " in done.stdout
    assert done.stderr == ""


def test_an_invalid_file_ends_with_78_and_every_problem(file: Path) -> None:
    """Problems go to stderr, one per line, with their number at the end."""
    file.write_text(GOOD + "log: {files: 0}\nchecks: {nods: {}}\nrecovery: {ladders: {exited: [restrat]}}\n")
    done = CliRunner().invoke(command, ["-c", str(file)])
    assert done.exit_code == 78
    assert done.stdout == ""
    lines = done.stderr.splitlines()
    assert [line.partition(": ")[0] for line in lines[:3]] == [f"{file}:3", f"{file}:4", f"{file}:5"]
    assert "did you mean 'nodes'?" in lines[1]
    assert "did you mean 'restart'?" in lines[2]
    assert lines[3] == "3 problems"


def test_an_application_that_cannot_be_inferred_is_a_warning(file: Path) -> None:
    """Several containers may pass commands on. Without a link to the autopilot there is no path."""
    both = "containers: [{name: app}, {name: other}]\n"
    link = "mavlink: {endpoints: [{url: 'udpin:0.0.0.0:14550'}]%s}\n"
    for text, warned in ((both, False), (both + link % "", True), (both + link % ", application: app", False)):
        file.write_text(text)
        done = CliRunner().invoke(command, [str(file)])
        assert done.exit_code == 0
        assert ("mavlink.application: which container passes commands" in done.stderr) is warned


def test_json_has_the_same_contents(file: Path) -> None:
    """With --json everything goes to stdout as one object, valid or not."""
    good = json.loads(CliRunner().invoke(command, ["--json", str(file)]).stdout)
    assert good["ok"]
    assert good["problems"] == []
    assert good["containers"] == 1
    file.write_text("log: {files: 0}\n")
    done = CliRunner().invoke(command, ["--json", str(file)])
    assert done.exit_code == 78
    assert json.loads(done.stdout) == {
        "ok": False,
        "problems": [{"file": str(file), "line": 1, "key": "log.files", "message": "is 0, allowed is 1 to 100"}],
    }


def test_units_are_counted_and_needs_may_name_them(file: Path) -> None:
    """The units come from the installed checks, so a dependency may name one of them and nothing else."""
    file.write_text(GOOD + "checks: {host: {needs: [nodes/a/one]}}\n")
    assert "nodes/a/one" in {unit.id for unit in read(str(file), {}).units["nodes"]}
    file.write_text(GOOD + "checks: {host: {needs: [nodes/a/two]}}\n")
    with pytest.raises(ConfigError, match="unknown unit 'nodes/a/two', did you mean 'nodes/a/one'"):
        read(str(file), {})


def test_a_cycle_of_installed_checks_is_rejected(file: Path) -> None:
    """A node depends on its container; a container that depends on nodes closes the cycle."""
    file.write_text(GOOD + "checks:\n  container:\n    needs: [nodes]\n")
    with pytest.raises(ConfigError, match=r"phm\.yaml:5: checks\.container\.needs\[0\]: dependency cycle: container"):
        read(str(file), {})


def test_a_check_that_cannot_be_built_is_named(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A plug-in that rejects its options is a problem of the configuration, unless it is disabled."""

    class Picky(api.Check):
        name, slot, layer = "picky", api.Slot.USER_1, api.Layer.CUSTOM

        @classmethod
        def build(cls, settings: api.Settings) -> list[api.Check]:
            raise ValueError("option 'volts' is missing")

        def run(self, world: api.World) -> api.Result:
            return api.ok("never reached")

    installed = {**registry.checks(), "picky": Picky}
    monkeypatch.setattr(configuration, "checks", lambda: installed)
    with pytest.raises(ConfigError, match=r"checks\.picky: the check cannot be built: ValueError: option 'volts'"):
        read(str(file), {})
    file.write_text(GOOD + "checks: {picky: {enabled: false}}\n")
    assert read(str(file), {}).settings.checks["picky"].enabled is False
