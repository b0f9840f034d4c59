"""Programs beside PHM: real plug-ins of Debian's monitoring-plugins, and programs that misbehave."""

from __future__ import annotations

import json
import os
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from phm import testing
from phm.core.clock import SystemClock
from phm.facts import CannotTell
from phm.probes.programs import AT_ONCE, OUTPUT_BYTES, Programs
from phm.transport.docker import DockerEngine
from phm_checks.custom import Custom
from tests.fakes.until import until

PLUGINS = Path("/usr/lib/nagios/plugins")
CLOCK = SystemClock()


@pytest.fixture
def programs() -> Programs:
    return Programs(DockerEngine("unix:///nowhere", 1.0, CLOCK), lambda name: None, CLOCK)


def python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def judged(programs: Programs, *command: str, **entry: Any) -> Any:
    settings = testing.settings(
        custom=[{"name": "x", "type": "command", "command": list(command), "timeout": 60, **entry}]
    )
    (check,) = Custom.build(settings)
    return check.run(testing.world(programs=programs))


def test_a_real_plugin_is_ok_with_its_text_and_its_values(programs: Programs) -> None:
    """check_load and check_disk write performance data."""
    load = judged(programs, str(PLUGINS / "check_load"), "-w", "9999,9999,9999", "-c", "9999,9999,9999")
    assert load.level.name == "OK" and load.summary.startswith("x: ") and "load average" in load.summary.lower()
    assert {"load1", "load5", "load15"} <= set(load.values)
    disk = judged(programs, str(PLUGINS / "check_disk"), "-w", "0", "-c", "0", "-p", "/")
    assert disk.level.name == "OK" and any(str(key).startswith("/") for key in disk.values), disk


def test_levels_of_a_real_plugin(programs: Programs) -> None:
    """check_dummy ends with the code of its argument; 3 means that it does not know."""
    plugin = str(PLUGINS / "check_dummy")
    assert [judged(programs, plugin, str(code), "words").level.name for code in (0, 1, 2)] == ["OK", "WARN", "ERROR"]
    assert judged(programs, plugin, "2", "pump dry").brief == "x CRITICAL: pump dry"
    with pytest.raises(CannotTell, match="exit code 3: UNKNOWN: words"):
        judged(programs, plugin, "3", "words")


def test_a_real_plugin_connects_to_a_real_server(programs: Programs) -> None:
    """check_tcp, once with and once without a listener."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        words = [str(PLUGINS / "check_tcp"), "-H", "127.0.0.1", "-p", str(listener.getsockname()[1])]
        ok = judged(programs, *words)
    assert (ok.level.name, "time_s" in ok.values) == ("OK", True)
    assert judged(programs, *words).level.name == "ERROR"


def test_a_program_gets_no_variables_of_phm(programs: Programs, monkeypatch: pytest.MonkeyPatch) -> None:
    """PHM's environment may hold keys."""
    monkeypatch.setenv("PHM_KEY", "secret")
    fact = programs.run(python("import json, os; print(json.dumps(dict(os.environ)))"), timeout_s=60)
    assert "PHM_KEY" not in json.loads(fact.output) and "PATH" in json.loads(fact.output)


def test_words_are_not_interpreted_by_a_shell(programs: Programs) -> None:
    """What would be a command for a shell is an argument."""
    fact = programs.run(["/bin/echo", "$(id)", ";", "id"], timeout_s=60)
    assert fact.output == "$(id) ; id\n"


def test_a_program_that_hangs_is_killed_with_its_children(programs: Programs, tmp_path: Path) -> None:
    """The whole process group ends."""
    code = (
        "import subprocess, sys, time, pathlib\n"
        "child = subprocess.Popen(['sleep', '600'])\n"
        f"new = pathlib.Path({str(tmp_path / 'new')!r})\n"
        "new.write_text(str(child.pid))\n"
        f"new.rename({str(tmp_path / 'pid')!r})\n"
        "time.sleep(600)"
    )
    for timeout_s in (2, 8, 32):  # a busy machine may need seconds to start Python
        with pytest.raises(CannotTell, match=f"did not end within {timeout_s} s and was killed"):
            programs.run(python(code), timeout_s=timeout_s)
        if (tmp_path / "pid").exists():
            break
    pid = int((tmp_path / "pid").read_text())

    def ended() -> bool:
        try:
            return (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] == "Z"
        except OSError:
            return True

    until(ended, "the end of the child")


def test_programs_that_cannot_be_killed_do_not_use_up_the_places(
    programs: Programs, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A thread waits for their end, as of one that hangs in the kernel. The same command is not started again before."""
    released = threading.Event()

    class Hung(subprocess.Popen[bytes]):
        def wait(self, timeout: float | None = None) -> int:
            if timeout is not None:
                raise subprocess.TimeoutExpired(self.args, timeout)
            assert threading.current_thread().name == "phm-reap", "it waits without a limit"
            released.wait()
            return super().wait()

        def poll(self) -> int | None:
            return super().poll() if released.is_set() else None

    commands = [["/bin/sleep", str(600 + number)] for number in range(AT_ONCE)]
    with monkeypatch.context() as patched:
        patched.setattr(subprocess, "Popen", Hung)
        for command in commands:
            with pytest.raises(CannotTell, match="was killed"):
                programs.run(command, timeout_s=0.1)
    assert programs.run(["/bin/echo", "fine"], timeout_s=60).output == "fine\n"
    with pytest.raises(CannotTell, match="has not ended"):
        programs.run(commands[0], timeout_s=0.1)
    released.set()
    until(lambda: all(program.poll() is not None for program in programs._hung.values()), "the ends")
    with pytest.raises(CannotTell, match="did not end"):
        programs.run(commands[0], timeout_s=0.1)


def test_a_child_that_keeps_the_output_open_delays_nothing(programs: Programs) -> None:
    """The program has ended; what it left behind is killed."""
    code = "import subprocess; print('fine', flush=True); subprocess.Popen(['sleep', '600'])"
    assert programs.run(python(code), timeout_s=60).output == "fine\n"


def test_much_output_is_cut(programs: Programs) -> None:
    """The program is read to its end, so that it does not block."""
    fact = programs.run(python("print('x' * 1000000)"), timeout_s=60)
    assert (fact.exit_code, len(fact.output)) == (0, OUTPUT_BYTES)


def test_errors_are_the_text_without_output(programs: Programs) -> None:
    """Many programs say there what is wrong."""
    fact = programs.run(python("import sys; sys.exit('no sensor')"), timeout_s=60)
    assert (fact.exit_code, fact.output) == (1, "no sensor\n")


@pytest.mark.parametrize("word", ["/nowhere/check", "/etc/passwd", "a\0b"])
def test_a_program_that_cannot_be_started_is_unknown(programs: Programs, word: str) -> None:
    """Not there, not executable, or no name at all: a statement about the configuration, not about the vehicle."""
    with pytest.raises(CannotTell, match="cannot be started"):
        programs.run([word], timeout_s=60)


def test_the_processes_that_phm_sees_are_listed(programs: Programs) -> None:
    """With their command lines, without PHM."""
    listed = {fact.pid: fact.command for fact in programs.processes()}
    assert os.getpid() not in listed and os.getppid() in listed and listed[os.getppid()]


def test_no_program_is_left_over_when_phm_stops(programs: Programs, tmp_path: Path) -> None:
    """Nor are its children, and none is started any more. A reload stops them, too."""
    file = tmp_path / "pids"
    code = f"import os, time; child = os.fork(); open({str(file)!r}, 'a').write(f'{{os.getpid()}}\\n'); time.sleep(60)"
    ended: list[str] = []

    def run() -> None:
        with pytest.raises(CannotTell) as caught:
            programs.run(python(code), timeout_s=60)
        ended.append(str(caught.value))

    thread = threading.Thread(target=run)
    thread.start()
    until(lambda: file.exists() and len(file.read_text().split()) == 2, "the program and its child run")
    programs.close()
    thread.join(60)
    assert ended and "was ended by signal 9" in ended[0]
    until(lambda: not any(_runs(int(pid)) for pid in file.read_text().split()), "both ended")
    with pytest.raises(CannotTell, match="PHM is stopping"):
        programs.run(python("pass"), timeout_s=5)


def _runs(pid: int) -> bool:
    try:
        return "\nState:\tZ" not in Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return False
