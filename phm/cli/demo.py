"""`phm demo`: three agents and two faults on this machine, without Docker, ROS and a vehicle."""

from __future__ import annotations

import contextlib
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

import click

from phm.cli.web_options import require_aiohttp

if TYPE_CHECKING:
    from phm.simulation.demo import Demo

STEP_S = 0.2
END_S = 15.0
START_S = 30.0
"""The times of the faults count from when all daemons run, or from here: a small computer takes seconds to start them."""


@click.command(epilog="Example: phm demo --web --for 600")
@click.option("--for", "seconds", type=click.IntRange(min=1), default=60, show_default=True, help="Seconds to run.")
@click.option(
    "--ground-port", type=click.IntRange(1024, 65535), default=14551, show_default=True, help="UDP port of `phm gcs`."
)
@click.option(
    "--first-port",
    type=click.IntRange(1024, 65000),
    default=14600,
    show_default=True,
    help="Ports of the autopilots: this one plus the id of the agent.",
)
@click.option(
    "--web",
    metavar="PORT",
    type=click.IntRange(0, 65535),
    is_flag=False,
    flag_value=8080,
    help="Also serve the page of `phm gcs --web` at 127.0.0.1, without a value at port 8080.",
)
@click.pass_context
def command(ctx: click.Context, seconds: int, ground_port: int, first_port: int, web: int | None) -> None:
    """Show three simulated agents and two faults on this machine.

    Needs neither Docker nor ROS.

    Starts three real PHM daemons with simulated autopilots, and shows them in `phm gcs`. After 18 s the autopilot of agent 2
    is killed (it is back after 45 s), after 28 s the PHM of agent 3. All of it ends with the command, and nothing is kept.
    Only loopback is used.
    """
    if sys.platform != "linux":
        raise click.UsageError("phm demo runs the daemon, which needs Linux: on this system use phm gcs alone.")
    from phm.simulation.demo import FAULTS, Demo, DemoPorts

    if web is not None:
        require_aiohttp("--web")
    for at_s, text in FAULTS:
        click.echo(f"after {at_s:.0f} s {text}", err=True)
    signal.signal(signal.SIGTERM, _end)
    with tempfile.TemporaryDirectory(prefix="phm-demo-") as folder:
        demo = Demo(Path(folder), DemoPorts(first_port, ground_port))
        try:
            demo.start()
            code = _watch(demo, seconds, ground_port, web)
        finally:
            demo.close()
    ctx.exit(code)


def _watch(demo: Demo, seconds: int, port: int, web: int | None) -> int:
    page = [] if web is None else ["--web", f"127.0.0.1:{web}", "--history", "none"]
    words = [sys.executable, "-m", "phm.cli", "gcs", "--for", str(seconds), *page, f"udpin:127.0.0.1:{port}"]
    started, ready = time.monotonic(), False
    gcs = subprocess.Popen(words)
    try:
        while True:
            if not ready and (demo.running() or time.monotonic() - started > START_S):
                started, ready = time.monotonic(), True
            if ready:
                demo.step(time.monotonic() - started)
            with contextlib.suppress(subprocess.TimeoutExpired):  # `phm gcs` still runs
                return gcs.wait(STEP_S)
    except KeyboardInterrupt:
        return _stop(gcs)


def _stop(gcs: subprocess.Popen[bytes]) -> int:
    """Wait for the end of `phm gcs`. Ctrl-C on a terminal reached it, too, and a second signal would cut its cleanup short: so
    SIGTERM is sent only to one that does not end by itself.
    """
    for ask in (gcs.poll, gcs.terminate):
        ask()
        with contextlib.suppress(subprocess.TimeoutExpired):
            return gcs.wait(END_S)
    gcs.kill()
    return gcs.wait()


def _end(number: int, frame: object) -> NoReturn:
    raise KeyboardInterrupt
