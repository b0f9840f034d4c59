"""`phm init`: creates a folder with everything needed to start PHM, for the application that runs on this machine."""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, NoReturn

import click

from phm.cli.web_options import address

if TYPE_CHECKING:
    from collections.abc import Sequence

    from phm.setup.answers import Answers
    from phm.setup.machine import Machine
    from phm.setup.questions import Interview, Question
    from phm.transport.docker import DockerEngine

SOCKET = "unix:///var/run/docker.sock"
ENGINE_S = 30.0
"""Longest wait for an answer. An engine that starts many containers may take longer than the 5 s that suit the daemon."""


def _engine() -> str:
    """Where `docker` looks for the engine, if PHM's container can reach it there, too."""
    url = os.environ.get("DOCKER_HOST", "")
    own = url.startswith(("tcp://127.", "tcp://localhost", "tcp://[::1]"))  # in PHM's container that is the container
    return url if url.startswith(("unix://", "tcp://")) and not own else SOCKET


def _deliver_at(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[str, int] | None:
    """The address of `--deliver`, which Docker publishes: one of this machine, no name."""
    import ipaddress

    found = address(ctx, param, value)
    try:
        if found is not None:
            ipaddress.ip_address(found[0])
    except ValueError:
        raise click.BadParameter(f"{value!r} needs an address of this machine, e.g. 10.0.0.7:9465") from None
    return found


@click.command(epilog="Example: phm init /opt/phm --id 7 --container ros_app --recover --mavlink udpout:10.0.0.5:14550")
@click.argument("directory", metavar="[DIR]", default="phm-agent", type=click.Path(file_okay=False, path_type=Path))
@click.option("--yes", is_flag=True, help="Ask nothing: use the defaults for what no option answers.")
@click.option("--force", is_flag=True, help="Replace files that exist.")
@click.option("--id", "agent_id", type=int, help="MAVLink system id of the vehicle.  [default: 1]")
@click.option("--name", help="Name of the agent in logs.  [default: agent_ID]")
@click.option(
    "--container",
    "containers",
    multiple=True,
    metavar="NAME",
    help="Container to watch; repeatable.  [default: all]",
)
@click.option("--recover/--no-recover", default=None, help="Whether PHM may restart the containers.  [default: no]")
@click.option(
    "--flight-critical", multiple=True, metavar="NAME", help="Container not to restart in flight; repeatable."
)
@click.option("--mavlink", metavar="URL", help="MAVLink endpoint, or none.  [default: port 14550 of this machine]")
@click.option("--network", type=click.Choice(["bridge", "host"]), help="Network of PHM.  [default: as the containers]")
@click.option("--logs", metavar="DIR", help="Folder of the log.  [default: logs, beside the compose file]")
@click.option("--image", help="Image of PHM.  [default: phm-sidecar:dev]")
@click.option(
    "--deliver",
    metavar="HOST:PORT",
    callback=_deliver_at,
    help="Permit configurations over IP, at this address of this machine, with a key.  [default: read-only for PHM]",
)
@click.option("--no-ros", is_flag=True, help="Do not look for ROS nodes.")
@click.option("--socket", default=_engine, help=f"Address of the Docker Engine.  [default: DOCKER_HOST, else {SOCKET}]")
def command(
    directory: Path,
    socket: str,
    yes: bool,
    force: bool,
    no_ros: bool,
    deliver: tuple[str, int] | None,
    **given: Any,
) -> None:
    """Create a folder with everything needed to start PHM.

    Looks at the running containers, asks at most five questions, and writes phm.yaml, compose.yaml, agent.env and
    fastdds.xml to DIR (default: phm-agent). Then `docker compose up -d` in that folder starts PHM.
    Changes no container. Exit code 0; 1: nothing was written.
    """
    from phm.facts import CannotTell
    from phm.setup import discovery, folder
    from phm.setup.answers import DELIVERED
    from phm.setup.questions import Interview
    from phm.transport.docker import DockerEngine, EngineNotConnected

    engine, dev = DockerEngine(socket, ENGINE_S), Path(os.environ.get("PHM_DEV_ROOT", "/dev"))
    try:
        machine = discovery.inspect_machine(engine, dev)
    except CannotTell as error:
        other = "; or name it with --socket" if isinstance(error, EngineNotConnected) else ""
        _fail(_remedy(socket) or f"{error}{other}")
    _show(machine)
    interview = Interview(machine, _given(given))
    answers = replace(_ask(interview, yes=yes), deliver=deliver)
    machine = replace(machine, serial_ports=tuple(discovery.serial_ports(dev, [answers.mavlink])))
    if not no_ros:
        answers = _with_nodes(machine, answers, engine)
    texts = _checked(machine, answers, directory)
    try:
        folder.check(directory, texts, force=force)
        logs = Path(os.path.normpath(directory / answers.logs))
        if not logs.is_relative_to(directory):
            folder.make_log_folder(logs)  # nothing is written if that fails
        folder.write(directory, texts, force=force)
        writable = folder.make_log_folder(logs)
        owned = not deliver or _prepare_deliveries(directory)
    except folder.FilesExist as error:
        _fail(str(error))
    except OSError as error:
        _fail(f"{error.filename or directory} cannot be written: {error.strerror or error}")
    click.echo(f"wrote {', '.join(sorted(texts))} to {directory}")
    _show_differences(machine, answers, texts)
    foreign = [path for path, own in ((directory / DELIVERED, owned), (logs, writable)) if not own]
    _finish(directory, answers, foreign)


def _prepare_deliveries(directory: Path) -> bool:
    """The key, and PHM's user as the owner of what it may change; whether that was possible. Raises OSError."""
    from phm.setup import folder
    from phm.setup.answers import DELIVERED, DELIVERY_KEY

    folder.make_key(directory / DELIVERY_KEY)
    return folder.give_to_phm(directory / DELIVERED)


def _remedy(socket: str) -> str:
    """For a user of this machine who may not open the engine's socket, what to do; else empty."""
    path = socket.removeprefix("unix://")
    if not os.path.exists(path) or os.access(path, os.R_OK | os.W_OK):
        return ""
    group = "create the group: `sudo groupadd docker`, and restart Docker"
    if os.stat(path).st_gid:
        group = "`sudo usermod -aG docker $USER` and log in again"
    # By its path: sudo looks only into its own folders, and pipx installs into ~/.local/bin.
    own = quote(os.path.abspath(sys.argv[0]))
    return f"you may not open {path}: run `sudo {own} init`, or {group}"


def _given(options: dict[str, Any]) -> dict[str, Any]:
    """Answers by the keys of `Interview`; None for what is to be asked."""
    renamed = {"id": options["agent_id"], "flight_critical": options["flight_critical"] or None}
    same = {key: options[key] for key in ("name", "recover", "mavlink", "network", "logs", "image")}
    return {**same, **renamed, "containers": options["containers"] or None}


def _ask(interview: Interview, *, yes: bool) -> Answers:
    from phm.setup.questions import InvalidAnswer

    try:
        interview.check()
        terminal = on_terminal()
        while question := interview.next():
            if not yes and not terminal:
                flags = ", ".join(interview.open_flags())
                _fail(f"there is no terminal to ask on: answer with {flags}, or take the defaults with --yes")
            if yes:
                interview.answer(question, question.default)
            else:
                _prompt(interview, question)
        return interview.answers()
    except InvalidAnswer as error:
        _fail(str(error))


def on_terminal() -> bool:
    """Whether questions can be answered."""
    return sys.stdin.isatty()


def _prompt(interview: Interview, question: Question) -> None:
    """Ask until the answer is possible."""
    from phm.setup.questions import InvalidAnswer

    while True:
        try:
            if isinstance(question.default, bool):
                interview.answer(question, click.confirm(question.text, default=question.default))
            else:
                shown = (
                    " ".join(question.default) or "none" if isinstance(question.default, tuple) else question.default
                )
                interview.answer(question, click.prompt(question.text, default=shown))
            return
        except InvalidAnswer as error:
            click.echo(str(error), err=True)


def _with_nodes(machine: Machine, answers: Answers, engine: DockerEngine) -> Answers:
    """The answers with the nodes of the ROS graph, where that can be read."""
    from phm.setup import answers as decided, ros_nodes
    from phm.setup.ros_settings import source, variables

    watched = decided.containers(machine, answers.containers) if answers.containers else ()
    found = source(machine, watched)
    try:
        # By address: the names of containers are not resolved here.
        names = ros_nodes.nodes(variables(found, watched, "host") if found is not None else {})
    except ros_nodes.NoGraph as error:
        click.echo(f"ROS nodes are not listed: {error}")
        return answers
    click.echo(f"ROS nodes: {', '.join(names) or 'none found'}")
    return replace(answers, nodes=ros_nodes.placed(names, watched, engine))


def _checked(machine: Machine, answers: Answers, directory: Path) -> dict[str, str]:
    """The files, of which phm.yaml is valid: a defect of PHM is reported here and not when the container starts."""
    from phm.config import ConfigError
    from phm.config.loader import loads
    from phm.setup.template_renderer import render

    texts = render(machine, answers)
    try:
        loads(texts[answers.configuration], str(directory / answers.configuration), environ={})
    except ConfigError as error:
        _fail(f"the configuration would not be valid, which is a defect of PHM; nothing was written\n{error}")
    return texts


def _show(machine: Machine) -> None:
    from phm.wire.text import one_line

    click.echo(f"Docker Engine {machine.engine}")
    for one in machine.applications:
        network = ", ".join(one.networks) or one.fact.network_mode
        devices = f", devices {', '.join(device.host_path for device in one.fact.devices)}" if one.fact.devices else ""
        click.echo(one_line(f"  {one.name}: {one.fact.status}, image {one.image}, network {network}{devices}"))
    if not machine.applications:
        click.echo("  no application container is running: start yours first, or add it to phm.yaml later")
    if machine.sidecars:
        click.echo(one_line(f"  PHM is already running as {', '.join(one.name for one in machine.sidecars)}"))


def _show_differences(machine: Machine, answers: Answers, texts: dict[str, str]) -> None:
    """What PHM's image lacks for the application, and containers that the ROS environment of PHM does not fit."""
    from phm.setup import answers as decided
    from phm.setup.ros_settings import image_need, remaining_differences, source
    from phm.setup.template_renderer import ENVIRONMENT
    from phm.wire.text import one_line

    watched = decided.containers(machine, answers.containers) if answers.containers else ()
    if (found := source(machine, watched)) is not None and (need := image_need(found)):
        click.echo(one_line(need))
    for name, difference in remaining_differences(texts[ENVIRONMENT], watched, answers.network):
        receives = "PHM does not receive" if difference.certain else "PHM may not receive"
        click.echo(one_line(f"{receives} the ROS nodes of {name}: {difference.text}"))


def _finish(directory: Path, answers: Answers, foreign: Sequence[Path]) -> None:
    """foreign: folders that PHM's user must write to, and may not."""
    from phm.setup.answers import DELIVERY_KEY
    from phm.setup.folder import PHM_USER

    click.echo("Next:")
    for path in foreign:
        if path != directory and path.is_relative_to(directory):
            click.echo(f"  sudo chown -R {PHM_USER}:{PHM_USER} {quote(str(path))}")
        else:  # other programs may need it, e.g. /var/log
            click.echo(f"  make {path} writable for user {PHM_USER}, or name another folder with --logs")
    click.echo(f"  cd {quote(str(directory))} && docker compose up -d")
    click.echo("  docker compose exec phm phm status")
    click.echo("`phm learn` then adds nodes, topics and rates, and `phm doctor` shows what PHM can use.")
    if answers.deliver:
        click.echo(
            f"Configurations can be delivered to {answers.deliver[0]}:{answers.deliver[1]} with {directory / DELIVERY_KEY}; copy it to "
            "the ground station. Who has it can run programs as PHM."
        )
    if answers.name and not answers.recover:
        click.echo("PHM reports faults and restarts nothing: `recover: true` in phm.yaml allows it.")


def _fail(text: str) -> NoReturn:
    click.echo(f"phm init: {text}", err=True)
    raise click.exceptions.Exit(1)
