"""The command line: output, exit code and start-up cost of each verb."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

import phm
from phm.checking.plan import build_plan
from phm.cli import VERBS, group
from phm.core.clock import SystemClock
from phm.core.model import Level, Outcome, Slot, UnitState
from phm.core.settings import Settings
from phm.reporters.status import StatusReporter
from phm.runtime.configuration import Configuration
from tests.fakes.records import closed, context, opened, unit
from tests.fakes.until import until

ROOT = Path(phm.__file__).parents[1]
DEAD = unit("nodes/agent_1/node_1", Slot.NODES, Level.ERROR, "Node /agent_1/node_1 is not running", brief="node_1 dead")
BLOCKED = unit("topics/agent_1/topic_1", Slot.TOPICS, Level.STALE, blocked_by=DEAD.unit)
HEALTHY = unit("host", Slot.HOST, summary="Host is calm")
HEALTH = {
    "uptime_s": 3725.0,
    "overdue": [],
    "dropped": {"log": 3},
    "problems": ["log: no space left"],
    "ros_restarts": 2,
    "flight_critical": {
        "containers": ["pilot", "vpn"],
        "armed": "unknown",
        "why": "the autopilot has been silent for 12 s",
    },
    "links": [
        {"name": "gcs", "open": False, "error": "refused"},
        {
            "name": "fc",
            "open": True,
            "error": "",
            "slowed": 2.5,
            "bytes_out": 421,
            "bytes_in": 9,
            "sent": {
                "transition": {"sent": 3, "coalesced": 1, "dropped": 0, "bytes": 90},
                "refresh": {"sent": 9, "coalesced": 1, "dropped": 4, "bytes": 252},
            },
        },
    ],
}


def invoke(*arguments: str, **environment: str) -> Result:
    return CliRunner().invoke(group, arguments, env={"COLUMNS": "200", **environment}, prog_name="phm")


def phm_process(
    *arguments: str, path: Path | None = None, environment: dict[str, str] | None = None, before: tuple[str, ...] = ()
) -> subprocess.CompletedProcess[str]:
    """The real program, in its own process; `path` is prepended to its module path."""
    places = [*([str(path)] if path else []), str(ROOT), str(ROOT / "checks")]
    return subprocess.run(
        [sys.executable, *before, "-m", "phm.cli", *arguments],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(places), **(environment or {})},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def in_time(done: subprocess.CompletedProcess[str]) -> subprocess.CompletedProcess[str] | None:
    """The answer of `phm status --healthy`; None: it came more than 5 s after the status was written, which it refuses for its age."""
    return None if " s old" in done.stderr else done


def running(run_dir: Path, *states: UnitState, alive: bool = True) -> StatusReporter:
    """A status as a daemon writes it, with one open and one resolved fault."""
    parts = context(
        Settings(run_dir=str(run_dir)),
        clock=SystemClock(),
        states=lambda: states,
        alive=lambda: alive,
        health=lambda: HEALTH,
    )
    status = StatusReporter.build(parts)
    if DEAD in states:
        status.handle(opened(DEAD))
        status.handle(opened(DEAD, "ab12-0"))
        status.handle(closed(DEAD, Outcome.RESOLVED, "restart", 4.5, "ab12-0"))
    status.tick()
    return status


# ---------------------------------------------------------------- the group


def test_the_help_of_each_verb_has_a_description_and_an_example() -> None:
    """The group's table agrees with the first line of each verb, and each verb shows an example."""
    for verb, line in VERBS.items():
        command = import_module(f"phm.cli.{verb.replace('-', '_')}").command
        assert (command.help or "").partition("\n")[0] == line
        shown = invoke(verb, "--help")
        assert shown.exit_code == 0
        assert f"phm {verb}" in shown.output.partition("Example")[2], f"{verb} has no example"
        assert line in invoke("--help").output


def test_the_version_is_that_of_the_package(tmp_path: Path) -> None:
    """`-V` and `--version` print one line."""
    assert invoke("-V").output == invoke("--version").output == f"phm {phm.__version__}\n"


def test_an_unknown_verb_is_a_usage_error() -> None:
    """Exit code 2, and the unknown word."""
    result = invoke("fly")
    assert result.exit_code == 2
    assert "No such command 'fly'" in result.output


def test_the_health_check_imports_almost_nothing(tmp_path: Path) -> None:
    """`phm status --healthy` runs every few seconds on a Pi: no pydantic, Docker, MAVLink, YAML, rich or rclpy."""
    status = running(tmp_path, HEALTHY)

    def answer() -> subprocess.CompletedProcess[str] | None:
        status.tick()
        return in_time(phm_process("status", "--healthy", "--run-dir", str(tmp_path), before=("-X", "importtime")))

    done = until(answer, "an answer in time")
    assert done.returncode == 0, done.stderr
    imported = {line.rpartition("|")[2].strip().partition(".")[0] for line in done.stderr.splitlines()}
    assert "click" in imported
    heavy = {"pydantic", "docker", "pymavlink", "rich", "rclpy", "yaml", "psutil", "serial", "requests", "asyncio"}
    assert imported.isdisjoint(heavy)
    ours = {line.rpartition("|")[2].strip() for line in done.stderr.splitlines() if "| " in line}
    lean = {"phm.cli", "phm.cli.options", "phm.cli.status", "phm.cli.web_options", "phm.wire", "phm.wire.status_file"}
    assert {name for name in ours if name.startswith("phm.")} <= lean


def test_an_unexpected_error_is_one_sentence() -> None:
    """No traceback unless requested, and exit code 70 (EX_SOFTWARE)."""
    script = "import phm.cli.status as s, phm.cli; s._read = lambda *a, **k: 1 / 0; phm.cli.main(['status'])"
    plain = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=ROOT, check=False)
    assert plain.returncode == os.EX_SOFTWARE
    assert plain.stderr == (
        "phm: internal error: ZeroDivisionError: division by zero (set PHM_TRACEBACK=1 for the traceback)\n"
    )
    full = subprocess.run(
        [sys.executable, "-c", script],
        env={**os.environ, "PHM_TRACEBACK": "1"},
        capture_output=True,
        text=True,
        cwd=ROOT,
        check=False,
    )
    assert "Traceback" in full.stderr


@pytest.fixture
def plugin(tmp_path: Path) -> Path:
    """A third-party package with the layout of pip: verbs and checks, some of them broken."""
    info = tmp_path / "acme-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: acme\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(
        "[phm.verbs]\nland = acme:land\nbroken = acme_missing:x\nnocommand = acme:number\n"
        "[phm.checks]\nacme_battery = acme:Battery\nacme_gone = acme_missing:Gone\n"
    )
    (tmp_path / "acme.py").write_text(
        "import click\n"
        "from phm import api\n"
        "number = 1\n"
        "@click.command()\n"
        "def land():\n"
        "    'Land.'\n"
        "    print('landing')\n"
        "class Battery(api.Check):\n"
        "    'The battery of the companion computer.'\n"
        "    name, slot, layer = 'acme_battery', api.Slot.USER_1, api.Layer.CUSTOM\n"
        "    def run(self, world): return api.ok('fine')\n"
    )
    return tmp_path


def test_a_verb_of_another_package_is_found(plugin: Path) -> None:
    """One entry point in `phm.verbs` is enough; the help names the package."""
    assert phm_process("land", path=plugin).stdout == "landing\n"
    shown = phm_process("--help", path=plugin).stdout
    assert "land" in shown
    assert "From acme." in shown


def test_a_broken_verb_of_another_package_says_why(plugin: Path) -> None:
    """The cause is reported in one sentence, and our own verbs still work."""
    broken = phm_process("broken", path=plugin)
    assert broken.returncode == 1
    assert broken.stderr == (
        "Error: verb 'broken' from 'acme_missing:x' cannot be loaded: "
        "ModuleNotFoundError: No module named 'acme_missing'\n"
    )
    assert "is not a click command" in phm_process("nocommand", path=plugin).stderr
    assert phm_process("--version", path=plugin).returncode == 0


# ---------------------------------------------------------------- checks


def test_checks_lists_installed_and_broken_checks(plugin: Path) -> None:
    """Name, slot, layer, package and description; a check that cannot be loaded has its cause, exit code 1."""
    done = phm_process("checks", "--json", path=plugin)
    assert done.returncode == 1
    rows = {row["name"]: row for row in json.loads(done.stdout)}
    assert rows["acme_battery"] == {
        "name": "acme_battery",
        "slot": 13,
        "layer": "custom",
        "source": "acme 1.2",
        "description": "The battery of the companion computer.",
        "problem": "",
    }
    assert "No module named 'acme_missing'" in rows["acme_gone"]["problem"]
    table = phm_process("checks", path=plugin).stdout
    assert "acme_battery" in table
    assert "not usable: module 'acme_missing' cannot be imported" in table


def test_the_dependency_graph_is_a_tree() -> None:
    """Each unit is listed once, below its dependency; as JSON with direct and all transitive dependents."""
    shipped = ("checks", "--graph", "-c", str(ROOT / "config" / "phm.yaml"))
    lines = invoke(*shipped).stdout.splitlines()
    rows = json.loads(invoke(*shipped, "--json").stdout)
    assert sorted(line.split()[0] for line in lines) == sorted(row["unit"] for row in rows)
    start = lines.index("  container/ros_app")
    assert lines[start - 1] == "engine"
    assert "        topics/agent_1/topic_1 (also needs nodes/agent_1/node_2)" in lines
    assert "host/disk (possible cause of any fault, blocks no unit)" in lines
    [network] = [row for row in rows if row["unit"] == "network/ros_app"]
    assert network["needs"] == ["container/ros_app"]
    memory_s = {row["unit"]: row["memory_s"] for row in rows}
    assert memory_s["network/ros_app"] == 0.0
    assert memory_s["rates/agent_1/topic_1"] > 3.0  # a topic is silent only after a while
    assert {unit.partition("/")[0] for unit in network["blocks"]} == {"nodes", "consensus", "topics", "rates"}


def test_an_installation_without_checks_is_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """An installation that checks nothing must not look healthy."""
    monkeypatch.setattr("phm.checking.registry.find", lambda group, base: [])
    result = invoke("checks")
    assert result.exit_code == 1
    assert "No checks are installed" in result.stderr


# ---------------------------------------------------------------- status


def test_status_shows_faults_first_then_units_links_and_counters(tmp_path: Path) -> None:
    """The most important information is first, and levels are words."""
    running(tmp_path, DEAD, BLOCKED, HEALTHY)
    result = invoke("status", "--run-dir", str(tmp_path))
    assert result.exit_code == 0, result.output
    shown = result.stdout
    order = [
        "agent_1 (agent 1), PHM",
        "up 1 h 2 min",
        "ab12-1",
        "blocks topics/agent_1/topic_1",
        "resolved by restart in 4.5 s",
        "ERROR",
        "STALE  blocked by nodes/agent_1/node_1",
        "Host is calm",
        "Status Array: [-, -, -, -, -, 0, -, -]   1 OK, 0 WARN, 1 ERROR, 1 STALE",
        "link gcs: closed: refused",
        "link fc: open (421 bytes sent; transition 3 sent, 1 coalesced; refresh 9 sent, 1 coalesced, 4 dropped; "
        "slowed down 2.5 times by radio flow control)",
        "flight-critical pilot, vpn: recovery suppressed, the autopilot has been silent for 12 s",
        "events dropped: log 3; ROS child restarts: 2",
        "problem: log: no space left",
    ]
    places = [shown.find(text) for text in order]
    assert -1 not in places, [text for text, place in zip(order, places, strict=True) if place < 0]
    assert places == sorted(places)


def test_output_without_a_terminal_has_no_colour(tmp_path: Path) -> None:
    """Pipes get plain text; a terminal gets colour unless NO_COLOR is set."""
    running(tmp_path, DEAD)
    assert "\x1b" not in invoke("status", "--run-dir", str(tmp_path)).stdout
    forced = {"FORCE_COLOR": "1", "TERM": "xterm-256color"}
    assert "\x1b[1;31m" in invoke("status", "--run-dir", str(tmp_path), **forced).stdout
    assert "\x1b[1;31m" not in invoke("status", "--run-dir", str(tmp_path), NO_COLOR="1", **forced).stdout


def test_external_text_cannot_control_the_terminal(tmp_path: Path) -> None:
    """Escape sequences and markup in a summary are shown literally."""
    running(tmp_path, unit("host", Slot.HOST, Level.WARN, "\x1b[2J[red]x[/red]\nSUCCESS"))
    shown = invoke("status", "--run-dir", str(tmp_path)).stdout
    assert r"\x1b[2J[red]x[/red]\nSUCCESS" in shown


def test_status_as_json_adds_the_verdict(tmp_path: Path) -> None:
    """The unmodified file, and whether the daemon is healthy."""
    running(tmp_path, DEAD)
    seen = json.loads(invoke("status", "--json", "--run-dir", str(tmp_path)).stdout)
    assert (seen["agent"], seen["healthy"], seen["problem"]) == ("agent_1", True, "")
    missing = invoke("status", "--json", "--run-dir", str(tmp_path / "none"))
    assert missing.exit_code == 1
    assert json.loads(missing.stdout)["healthy"] is False


def test_healthy_is_about_the_daemon_not_the_vehicle(tmp_path: Path) -> None:
    """A sidecar that reports a dead node works: Docker must not restart it for that."""
    running(tmp_path, DEAD)
    result = invoke("status", "--healthy", PHM_RUN_DIR=str(tmp_path))
    assert (result.exit_code, result.stdout) == (0, "PHM is healthy: monitoring 1 units.\n")


def test_a_stalled_scheduler_is_unhealthy(tmp_path: Path) -> None:
    """A process that still writes but no longer checks is not OK."""
    running(tmp_path, alive=False)
    result = invoke("status", "--healthy", "--run-dir", str(tmp_path))
    assert result.exit_code == 1
    assert result.stderr.startswith("PHM is not healthy: PHM's checks have stalled")


def test_without_a_daemon_status_says_so(tmp_path: Path) -> None:
    """One sentence on stderr, exit code 1, nothing on stdout."""
    for flag in ((), ("--healthy",)):
        result = invoke("status", *flag, "--run-dir", str(tmp_path))
        assert (result.exit_code, result.stdout) == (1, "")
        assert len(result.stderr.splitlines()) == 1
        assert "PHM is not running" in result.stderr
        assert "was started seconds ago (try again)" in result.stderr


DAEMON = """
import sys, time
from phm.core.clock import SystemClock
from phm.reporters.base import ReporterContext
from phm.runtime.sections import reporter_settings
from phm.reporters.status import StatusReporter
from phm.core.settings import Settings
status = StatusReporter.build(
    ReporterContext(reporter_settings(Settings(run_dir=sys.argv[1])), SystemClock(), "b", tuple, lambda: True, dict))
status.tick()
print("written", flush=True)
sys.stdin.readline()
"""


def test_the_status_of_a_killed_daemon_is_never_healthy(tmp_path: Path) -> None:
    """After SIGKILL the file still exists and is recent, and `--healthy` fails nevertheless."""

    def answer(*, killed: bool) -> subprocess.CompletedProcess[str] | None:
        """About a new daemon, which has just written its status."""
        command = [sys.executable, "-c", DAEMON, str(tmp_path)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "written\n"
            if killed:
                process.send_signal(signal.SIGKILL)
                process.wait(60)
                assert (tmp_path / "status.json").exists()
            return in_time(phm_process("status", "--healthy", "--run-dir", str(tmp_path)))

    assert until(lambda: answer(killed=False), "an answer in time").returncode == 0
    done = until(lambda: answer(killed=True), "an answer in time")
    assert done.returncode == 1
    assert "PHM was killed" in done.stderr
    shown = phm_process("status", "--run-dir", str(tmp_path))
    assert shown.returncode == 1
    assert "The following is out of date." in shown.stdout


def test_watch_shows_the_status_until_interrupted(tmp_path: Path) -> None:
    """`--watch` prints periodically, and Ctrl-C ends it cleanly."""
    status = running(tmp_path, DEAD)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [sys.executable, "-m", "phm.cli", "status", "--watch", "--run-dir", str(tmp_path)],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # also if the tests themselves ignore it
    ) as process:
        assert process.stdout is not None
        seen = 0
        for line in process.stdout:
            status.tick()
            seen += "Status Array" in line
            if seen == 2:
                break
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=120)
    assert (process.returncode, errors) == (0, "")


def test_output_options_exclude_each_other(tmp_path: Path) -> None:
    """Two of --json, --healthy, --watch are a usage error."""
    assert invoke("status", "--json", "--healthy").exit_code == 2


# ---------------------------------------------------------------- once and run


def with_daemon(monkeypatch: pytest.MonkeyPatch, **functions: Any) -> None:
    """Settings without a file, and replaced functions of the daemon."""
    nothing = Configuration("phm.yaml", Settings(), {}, build_plan(Settings(), {}))
    monkeypatch.setattr("phm.runtime.configuration.read", lambda path, **more: nothing)
    for name, function in functions.items():
        monkeypatch.setattr(f"phm.runtime.single_pass.{name}", function)


def test_once_prints_the_report_as_json(monkeypatch: pytest.MonkeyPatch) -> None:
    """The documented keys first; exit code 1 since a check has level ERROR."""
    with_daemon(monkeypatch, run_once=lambda configuration: (DEAD, BLOCKED, HEALTHY))
    result = invoke("once", "--json")
    assert result.exit_code == 1
    seen = json.loads(result.stdout)
    assert list(seen) == ["agent", "status_array", "slots", "checks"]
    assert seen["slots"] == {"6": "ERROR", "7": "STALE", "9": "OK"}
    keys = ["id", "slot", "layer", "level", "summary", "blocked_by", "duration_ms"]
    assert [list(check)[:7] for check in seen["checks"]] == [keys] * 3
    assert [check["level"] for check in seen["checks"]] == ["ERROR", "STALE", "OK"]


def test_once_prints_a_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """Slots in order, level words, array; exit code 0 without ERROR, even if a unit is STALE."""
    with_daemon(monkeypatch, run_once=lambda configuration: (HEALTHY, BLOCKED))
    result = invoke("once")
    assert result.exit_code == 0, result.output
    assert result.stdout.index("blocked by") < result.stdout.index("Host is calm")
    assert "Status Array: [-, -, -, -, -, -, -, -]" in result.stdout


def test_run_ends_with_the_exit_code_of_the_daemon(monkeypatch: pytest.MonkeyPatch) -> None:
    """The return value of `phm.runtime.service.run` is the exit code."""
    with_daemon(monkeypatch)
    monkeypatch.setattr("phm.runtime.service.run", lambda configuration, read: 3)
    monkeypatch.setattr("phm.cli.run.end_process", sys.exit)  # this process continues
    assert invoke("run").exit_code == 3


@pytest.mark.parametrize("verb", ["run", "once"])
def test_an_invalid_configuration_ends_before_anything_is_opened(verb: str, tmp_path: Path) -> None:
    """Exit code 78, the problems on stderr, no traceback, nothing on stdout."""
    bad = tmp_path / "phm.yaml"
    bad.write_text("agent: {id: 51}\nintervall: 3\n")
    done = phm_process(verb, "-c", str(bad))
    assert (done.returncode, done.stdout) == (78, "")
    assert "intervall" in done.stderr
    assert "51" in done.stderr
    assert "Traceback" not in done.stderr


def test_once_makes_a_real_pass(plugin: Path) -> None:
    """A configuration, an installed third-party check and the real daemon: the report has its unit."""
    (plugin / "phm.yaml").write_text("agent: {name: scout, id: 7}\ninterval: 20s\n")
    done = phm_process("once", "-c", str(plugin / "phm.yaml"), "--json", path=plugin)
    seen = json.loads(done.stdout)
    assert seen["agent"] == "scout"
    levels = {check["id"]: check["level"] for check in seen["checks"]}
    assert levels["acme_battery"] == "OK"
    assert done.returncode == int("ERROR" in levels.values())


# ---------------------------------------------------------------- the reference page


def test_the_page_names_every_verb_option_and_key(tmp_path: Path) -> None:
    """`docs/reference/cli.md` has a section for each verb, and names each option and each key of the status file."""
    page = (ROOT / "docs" / "reference" / "cli.md").read_text()
    for verb in VERBS:
        assert f"\n## phm {verb}\n" in page
        for parameter in import_module(f"phm.cli.{verb.replace('-', '_')}").command.params:
            assert any(option in page for option in parameter.opts), f"{verb} {parameter.opts} is not described"
    running(tmp_path, HEALTHY)
    keys = json.loads((tmp_path / "status.json").read_text())
    assert [key for key in keys if f"`{key}`" not in page] == []
