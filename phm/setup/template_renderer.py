"""Makes the files of the folder from what was found and decided. Pure: the templates are in `phm/templates`."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from importlib.resources import files
from string import Template

from phm.config.loader import DELIVERED
from phm.facts import DeviceMapping
from phm.setup import answers as decided
from phm.setup.answers import NO_MAVLINK, Answers
from phm.setup.machine import Application, Machine
from phm.setup.ros_settings import APPLICATION_PROFILE, ros_settings
from phm.setup.yaml_text import compose_quoted, quoted
from phm.transport.own_network import HOST_NAME, listens_only_inside

CONFIGURATION, COMPOSE, ENVIRONMENT, PROFILE = "phm.yaml", "compose.yaml", "agent.env", "fastdds.xml"
OVERRIDE = "compose.override.yaml"
_SERIAL_MAJORS = (
    ("c 166:* rw", "/dev/ttyACM*, flight controllers on USB"),
    ("c 188:* rw", "/dev/ttyUSB*, USB adapters and telemetry radios"),
    ("c 204:* rw", "/dev/ttyAMA*, serial ports of a Raspberry Pi"),
)
_EMPTY = " []"


def render(machine: Machine, answers: Answers) -> dict[str, str]:
    """The text of each file, by its path in the folder. The containers of `answers` must be among those of `machine`."""
    watched = decided.containers(machine, answers.containers) if answers.containers else ()
    keys = decided.keys(watched)
    ros = ros_settings(machine, watched, _template(PROFILE), answers.network)
    made = {
        answers.configuration: Template(_template(CONFIGURATION)).substitute(
            agent=answers.name,
            id=answers.id,
            containers=_containers(watched, keys, answers, machine.other_devices),
            ros=_ros(answers, keys),
            mavlink=_mavlink(answers),
            delivery=_delivery(answers),
            docker="" if machine.socket else f"\ndocker:\n  socket: {quoted(machine.url)}\n",
        ),
        COMPOSE: Template(_template(COMPOSE)).substitute(
            image=answers.image,
            groups=_groups(machine),
            network=_network(answers),
            devices=_devices(answers),
            socket=f"      - {compose_quoted(f'{machine.socket}:/var/run/docker.sock')}\n" if machine.socket else "",
            logs=compose_quoted(f"{answers.logs}:/var/log/phm"),
        ),
        ENVIRONMENT: Template(_template(ENVIRONMENT)).substitute(agent=answers.name, id=answers.id, ros=ros.lines),
        PROFILE: _template(PROFILE),
    }
    if answers.deliver:
        made[OVERRIDE] = Template(_template(OVERRIDE)).substitute(ports=_ports(answers, answers.deliver))
    return {**made, **({APPLICATION_PROFILE: ros.profile} if ros.profile else {})}


def _template(name: str) -> str:
    return (files("phm") / "templates" / name).read_text(encoding="utf-8")


# ------------------------------------------------------------ phm.yaml


def _containers(
    watched: Sequence[Application], keys: dict[str, str], answers: Answers, other_devices: Collection[str]
) -> str:
    if not watched:
        return f"{_EMPTY}\n  #- name: ros_app            # as in `docker ps`"
    return "".join(
        "\n" + "\n".join(_container(one, keys[one.name], answers, other_devices, first=one is watched[0]))
        for one in watched
    )


def _container(
    one: Application, key: str, answers: Answers, other_devices: Collection[str], *, first: bool
) -> list[str]:
    lines = [f"  - name: {quoted(one.name)}"]
    if key != one.name:
        lines.append(f"    alias: {quoted(key)}")
    why = "  # PHM may start, restart, unpause and reconnect it" if first else ""
    lines.append(f"    recover: {'true' if answers.recover else 'false'}{why}")
    if one.name in answers.flight_critical:
        lines.append(
            "    flight_critical: true  # restarted only while the autopilot reports disarmed, or after `phm approve`"
        )
    if one.fact.healthcheck is None:
        lines.append("    # Its image has no HEALTHCHECK, so its health is not judged.")
    if one.networks:
        lines.append(f"    networks: [{', '.join(map(quoted, one.networks))}]")
    elif one.fact.network_mode == "host":
        lines.append("    # It uses the host's network, as PHM does.")
    lines += _mapped(one.fact.devices, other_devices)
    lines.append("    # files: [{path: /ws/install/setup.bash}]")
    return lines


def _mapped(devices: Sequence[DeviceMapping], other_devices: Collection[str]) -> list[str]:
    lines = []
    for device in devices:
        path, inside = device.host_path, device.container_path
        mapped = f", in_container: {quoted(inside)}" if inside and inside != path else ""
        if path in other_devices:
            lines.append(f"      # {quoted(path)} is a folder or a block device: name the character devices in it.")
        else:
            lines.append(f"      - {{path: {quoted(path)}{mapped}}}")
    listed = any(line.lstrip().startswith("-") for line in lines)
    return [f"    {'' if listed else '#'}devices:", *lines] if lines else []


def _ros(answers: Answers, keys: dict[str, str]) -> str:
    if not answers.nodes:
        return (
            "\n  # Nodes that must run, and topics that must have data:\n  nodes: []\n"
            "    # - {name: /agent_1/planner}\n  topics: []\n"
            "    # - {name: /agent_1/state, rate: 10Hz, publishers: [/agent_1/planner]}"
        )
    lines = [
        "",
        "  # Nodes that were running when `phm init` looked. Remove those that are not always needed.",
        "  nodes:",
    ]
    for name, container in answers.nodes:
        where = f", container: {quoted(keys[container])}" if container in keys and len(keys) > 1 else ""
        lines.append(f"    - {{name: {quoted(name)}{where}}}")
    lines += ["  topics: []", "    # - {name: /agent_1/state, rate: 10Hz, publishers: [/agent_1/planner]}"]
    return "\n".join(lines)


def _mavlink(answers: Answers) -> str:
    if answers.mavlink == NO_MAVLINK:
        return (
            "\n  # Where to report: a ground station, a MAVLink router, or the serial port of the autopilot.\n"
            '  endpoints: []\n    # - {name: ground, url: "udpout:192.168.1.10:14550", leads_to: ground}'
        )
    name = "autopilot" if answers.mavlink.startswith("/") else "ground"
    return (
        "\n  endpoints:\n"
        f"    - name: {name}\n"
        f"      url: {quoted(answers.mavlink)}\n"
        "      # ground, autopilot, router (to which both are connected), or both: an autopilot that passes frames to the ground\n"
        "      leads_to: both"
    )


def _delivery(answers: Answers) -> str:
    if not answers.deliver:
        return ""
    listen = _shown(answers.deliver if answers.network == "host" else ("0.0.0.0", answers.deliver[1]))
    return (
        "\n# `phm deliver` and the Checks page may replace this file with the key.\n"
        f"delivery:\n  listen: {quoted(listen)}\n  key: {DELIVERED}/delivery.key\n"
    )


# ------------------------------------------------------------ compose.yaml


def _ports(answers: Answers, deliver: tuple[str, int]) -> str:
    """The published port: the container does not have the address of the host."""
    if answers.network == "host":
        return ""
    return f"    ports:\n      - {compose_quoted(f'{_shown(deliver)}:{deliver[1]}')}\n"


def _shown(where: tuple[str, int]) -> str:
    host, port = where
    return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"


def _groups(machine: Machine) -> str:
    """Groups that own the engine's socket and the serial ports, each once."""
    found: dict[int, str] = {}
    if machine.socket_group_id is not None:
        found[machine.socket_group_id] = machine.socket
    for port in machine.serial_ports:
        if port.group_id:
            found.setdefault(port.group_id, port.path)
    return "".join(f'\n      - "{number}" # owner of {path}' for number, path in found.items()) or _EMPTY


def _network(answers: Answers) -> str:
    if answers.network == "host":
        return "    # For an application on the host's network: ROS 2 discovery does not cross from there to a bridge.\n    network_mode: host"
    lines = [
        "    # PHM connects itself to the networks that phm.yaml names.",
        "    extra_hosts:",
        f'      - "{HOST_NAME}:host-gateway" # this machine, e.g. for MAVLink',
        *_listening(answers.mavlink),
    ]
    return "\n".join(lines)


def _listening(url: str) -> list[str]:
    """The port of an endpoint that waits for peers. Without it, only containers on PHM's networks could reach PHM there."""
    scheme, _, rest = url.partition(":")
    if scheme not in ("udpin", "tcpin"):
        return []
    if listens_only_inside(url):
        return [f"    # {url} listens only inside PHM's container: write 0.0.0.0 in place of the address in phm.yaml."]
    port = rest.rpartition(":")[2]
    published = compose_quoted(f"127.0.0.1:{port}:{port}/{scheme.removesuffix('in')}")
    return [
        "    # The MAVLink endpoint, for programs of this machine. For those of other machines, write an address of this",
        "    # machine instead of 127.0.0.1.",
        f"    ports:\n      - {published}",
    ]


def _devices(answers: Answers) -> str:
    """The serial port of a MAVLink endpoint; for other ports the rules that `open: always` needs, as comments."""
    if answers.mavlink.startswith("/"):
        lines = [
            "    # Docker looks for it at every start of the container: without the port PHM does not start. For one that may be",
            "    # missing or come back with another number (USB), the rule of its kind instead of `devices`: then PHM opens it",
            "    # in /host/dev.",
            f"    devices:\n      - {_mapping(answers.mavlink)}",
        ]
    else:
        lines = ["    # PHM looks at devices in /host/dev. To open them (`open: always`), one rule for each kind:"]
    lines += ["    # device_cgroup_rules:", *(f'    #   - "{rule}" # {what}' for rule, what in _SERIAL_MAJORS)]
    return "\n".join(lines) + "\n"


def _mapping(path: str) -> str:
    """A device at the same path in the container. In the short form, a colon would end the path."""
    port = compose_quoted(path)
    if ":" in path:
        return f"{{source: {port}, target: {port}, permissions: rwm}}"
    return compose_quoted(f"{path}:{path}")
