"""Autopilots that are not ours: a real ArduPilot or PX4 for each agent, as a container in the air's network namespace.

There, each is where its own convention has it: ArduPilot's instance i, system id i + 1, on TCP 5760 + 10 i (and serial
port 1 on the second next), PX4's instance i on UDP 14540 + i.
"""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import yaml

from sitl.swarm.options import Options

SERVICE = "autopilot"
MOUNTED = "/opt/autopilot"
PARAMETERS = "/opt/phm.parm"
MOST_PX4 = 10
"""From instance 10 on, PX4 gives all vehicles the same port."""
ARDUPILOT = (
    "{binary} --model quad --instance {instance} --sysid {id} --wipe --home {home} --defaults {parameters} --speedup 1"
)
PX4 = "{binary} -d -i {instance}"
HOME = "47.3977418,{longitude:.7f},408,0"
PARAMETER_LINES = """\
# PHM is on serial port 1. Its frames go to the ground through the vehicle's router; passed on by the autopilot as well, each
# would take the radio twice. Needs 4.7 or later: earlier firmware has bit 10 of SERIAL1_OPTIONS for it, with which 4.7 refuses
# to arm. Without a frame it refuses, too.
SERIAL1_PROTOCOL 2
MAV2_OPTIONS 2
FRAME_CLASS 1
FRAME_TYPE 0
"""


def check(options: Options) -> None:
    """ValueError when a real autopilot is asked for and cannot be had this way."""
    if options.autopilot == "sim":
        return
    if not (options.autopilot_path or options.autopilot_image):
        raise ValueError(
            f"--autopilot {options.autopilot} needs --autopilot-path FILE, a SITL binary of this machine, or --autopilot-image IMAGE"
        )
    if not options.autopilot_image and not Path(options.autopilot_path).is_file():
        raise ValueError(f"--autopilot-path {options.autopilot_path}: there is no such file")
    if options.autopilot == "px4" and options.agents > MOST_PX4:
        raise ValueError(f"{options.agents} agents with PX4: allowed are up to {MOST_PX4}")


def url(options: Options, number: int) -> str:
    """Where the air process finds the autopilot of an agent; empty for a simulated one."""
    instance = number - 1
    if options.autopilot == "ardupilot":
        return f"tcp:127.0.0.1:{5760 + 10 * instance}"
    if options.autopilot == "px4":
        return f"udpin:127.0.0.1:{14540 + instance}"
    return ""


def serial_port(options: Options, number: int) -> int | None:
    """The port of ArduPilot's serial port 1, for PHM itself; None where there is no such thing."""
    return 5762 + 10 * (number - 1) if options.autopilot == "ardupilot" else None


def urls(options: Options) -> str:
    """As `sitl.simulation.link_emulator --pilots` takes them."""
    pairs = ((number, url(options, number)) for number in range(1, options.agents + 1))
    return ",".join(f"{number}={found}" for number, found in pairs if found)


def service(options: Options, number: int, parameters: Path) -> dict[str, Any]:
    """A Compose file with the autopilot of one agent, to be laid over the agent's own."""
    binary = options.autopilot_path if options.autopilot_image else MOUNTED
    template = options.autopilot_command or (ARDUPILOT if options.autopilot == "ardupilot" else PX4)
    words = template.format(
        binary=binary or ("arducopter" if options.autopilot == "ardupilot" else "px4"),
        instance=number - 1,
        id=number,
        parameters=PARAMETERS,
        home=HOME.format(longitude=8.5455939 + 1.3e-4 * number),
    )
    mounts = [f"{parameters}:{PARAMETERS}:ro"]
    if not options.autopilot_image:
        mounts.append(f"{options.autopilot_path}:{MOUNTED}:ro")
    made = {
        "image": options.autopilot_image or "${PHM_APP_IMAGE:-phm-app:dev}",
        "labels": {"phm.sitl.swarm": "${PHM_SWARM}"},
        "entrypoint": shlex.split(words),
        "command": [],
        "working_dir": "/tmp",
        "network_mode": "container:${PHM_SWARM}-air-air-1",
        "environment": {"PX4_SIM_MODEL": "sihsim_quadx"} if options.autopilot == "px4" else {},
        "volumes": mounts,
        "healthcheck": {"disable": True},
        "mem_limit": "1g",
        "stop_grace_period": "2s",
    }
    return {"services": {SERVICE: made}}


def write(options: Options, number: int, folder: Path) -> list[str]:
    """Put the Compose file and what it mounts into the folder; the files to lay over the agent's own, none for `sim`."""
    if options.autopilot == "sim":
        return []
    folder.mkdir(parents=True, exist_ok=True)
    parameters, file = folder / "phm.parm", folder / "autopilot.yaml"
    parameters.write_text(PARAMETER_LINES, "utf-8")
    file.write_text(yaml.safe_dump(service(options, number, parameters), sort_keys=False), "utf-8")
    return [str(file)]
