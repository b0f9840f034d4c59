"""config/systemd/phm.service: valid for systemd, and right for what PHM does."""

from __future__ import annotations

import configparser
import re
import shutil
import subprocess
from pathlib import Path

from phm.core.settings import Settings
from phm.runtime.daemon import STALLED_END_S

UNIT = Path(__file__).resolve().parents[2] / "config" / "systemd" / "phm.service"


def service() -> configparser.SectionProxy:
    """The section [Service]; no key of it occurs twice."""
    unit = configparser.ConfigParser(interpolation=None)
    unit.optionxform = str  # type: ignore[method-assign, assignment]
    unit.read_string(UNIT.read_text("utf-8"))
    return unit["Service"]


def complaints(text: str, folder: Path) -> list[str]:
    """What `systemd-analyze verify` says about a unit, whose programs need not be installed here. Without systemd: only lines
    that are neither a comment, a section nor an assignment."""
    program = shutil.which("systemd-analyze")
    if program is None:
        return [line for line in text.splitlines() if not re.fullmatch(r"|#.*|\[[A-Z]\w+\]|[A-Z]\w+=.*", line)]
    file = folder / "phm.service"
    file.write_text(re.sub(r"(?m)^(Exec\w+)=\S+", r"\1=/bin/true", text), encoding="utf-8")
    done = subprocess.run(
        [program, "verify", "--man=no", str(file)], capture_output=True, text=True, timeout=60, check=False
    )
    return [line for line in done.stderr.splitlines() if "phm.service" in line]


def test_systemd_accepts_the_unit(tmp_path: Path) -> None:
    """Each key and value, as systemd-analyze says where it is installed; a line that is none is found everywhere."""
    text = UNIT.read_text("utf-8")
    assert complaints(text, tmp_path) == []
    assert complaints(f"{text}WantedBy multi-user.target\n", tmp_path)


def test_the_unit_fits_what_phm_does() -> None:
    """PHM notifies its start, reloads by SIGHUP, and exits by itself before the watchdog of systemd ends it."""
    found, settings = service(), Settings.model_validate({"agent": {"id": 1}})
    assert (found["Type"], found["NotifyAccess"]) == ("notify", "main")
    assert found["ExecReload"].endswith("kill -HUP $MAINPID")
    assert float(found["WatchdogSec"]) > STALLED_END_S
    assert found["Restart"] == "always" and found["RestartPreventExitStatus"].split() == ["75", "78"]
    assert settings.run_dir == f"/run/{found['RuntimeDirectory']}"
    assert settings.state_dir == f"/var/lib/{found['StateDirectory']}"
    assert settings.log.directory == f"/var/log/{found['LogsDirectory']}"


def test_the_memory_limit_is_that_of_the_compose_file() -> None:
    """Above `ros.max_memory`, at which PHM replaces its ROS child; and the kernel may end that child without the end of the service."""
    found, settings = service(), Settings.model_validate({"agent": {"id": 1}})
    compose = (UNIT.parents[2] / "docker" / "compose.yaml").read_text("utf-8")
    assert f"mem_limit: {found['MemoryMax'].lower()}\n" in compose
    assert int(found["MemoryMax"].removesuffix("M")) * 1e6 > settings.ros.max_memory
    assert found["OOMPolicy"] == "continue"
