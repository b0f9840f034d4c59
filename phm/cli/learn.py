"""`phm learn`: watches a healthy agent and writes or updates its configuration."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from phm.cli.options import EX_CONFIG, config_option, json_option

if TYPE_CHECKING:
    from phm.learn.baseline import Baseline


@click.command(epilog="Example: phm learn --for 60s --files ros_app:/ws/install --output phm.yaml")
@click.option("--for", "duration", default="60s", show_default=True, help="How long to watch, e.g. 90s or 10min.")
@config_option
@click.option(
    "-o", "--output", type=click.Path(dir_okay=False, path_type=Path), help="File to write.  [default: print it]"
)
@click.option("--fresh", is_flag=True, help="Start with an empty configuration instead of an existing one.")
@click.option(
    "--container",
    "containers",
    multiple=True,
    help="Watch only this container; repeatable.  [default: those in the configuration, else all that run]",
)
@click.option(
    "--files",
    "folders",
    multiple=True,
    metavar="CONTAINER:/PATH",
    help="Make a manifest of all files in this folder; repeatable.",
)
@click.option("--diff", is_flag=True, help="Print the differences from the existing configuration.")
@json_option
@click.pass_context
def command(
    ctx: click.Context,
    duration: str,
    config: str | None,
    output: Path | None,
    fresh: bool,
    containers: tuple[str, ...],
    folders: tuple[str, ...],
    diff: bool,
    as_json: bool,
) -> None:
    """Watch a healthy agent and write a configuration for it.

    Learns containers, networks, devices, files, nodes, topics with their rates, and the autopilot. An existing
    configuration keeps its comments and everything that was not observed. What is uncertain is marked by a comment that
    begins with `learned:`. Reads only: no recovery, no MAVLink, no change to containers or networks.

    Exit code 0: done; 1: nothing could be watched, or the file could not be written; 78: the configuration is invalid.
    """
    from phm.config import ConfigError
    from phm.config.loader import read_file
    from phm.learn import output as files
    from phm.learn.agent_observer import AgentObserver, ObservationFailed
    from phm.learn.baseline import learn
    from phm.learn.baseline_merger import merge

    if folders and output is None:
        raise click.UsageError("--files writes a manifest beside the configuration: add --output.")
    base = _base(config, output, fresh)
    request = _request(duration, containers, folders)
    try:
        text = read_file(base).replace("\r\n", "\n") if base is not None else ""
        settings = files.settings_of(text, str(base or "phm.yaml"), os.environ)
        if output is not None:
            _check_folder(output)
        from phm.core.clock import SystemClock

        seen = AgentObserver(settings, request, SystemClock(), _progress).run()
        baseline = learn(seen, settings.agent.id)
        new = merge(text, baseline, os.environ)
        files.check(new, str(output or base or "phm.yaml"), os.environ)
        if not (baseline.containers or baseline.nodes or baseline.mavlink.values):
            raise ObservationFailed(
                f"nothing was learned: {'; '.join(seen.problems) or 'no container or ROS node is running'}"
            )
    except ConfigError as error:
        click.echo(str(error), err=True)
        ctx.exit(EX_CONFIG)
    except (OSError, UnicodeDecodeError, ObservationFailed) as error:
        raise click.ClickException(str(error)) from None
    failed = _write(output, new, baseline) if output is not None else None
    printed = output is None or failed is not None
    _print(text, new, str(base or "phm.yaml"), baseline, diff=diff and failed is None, as_json=as_json, printed=printed)
    if failed is not None:
        missing = ", but its manifests may be missing" if baseline.manifests else ""
        raise click.ClickException(f"{output} was not written ({failed}): what was learned is on stdout{missing}")


def _base(config: str | None, output: Path | None, fresh: bool) -> Path | None:
    """The configuration to update: --config, else the file to write, else the default one; None: there is none."""
    from phm.config import find

    if fresh:
        return None
    if config is not None:
        return Path(config)
    if output is not None and output.exists():
        return output
    default = find(None)
    return default if default.exists() else None


def _check_folder(output: Path) -> None:
    """Before the measurement, which may take hours."""
    from phm.learn.output import check_folder

    try:
        check_folder(output)
    except OSError as error:
        raise click.ClickException(
            f"--output {output}: cannot write there ({error.strerror}), so nothing was measured: name a folder that PHM's user may "
            'write to, or run it as yourself: docker compose run -u "$(id -u):$(id -g)" ...'
        ) from None


def _write(output: Path, text: str, baseline: Baseline) -> OSError | None:
    """Returns what prevented it."""
    from phm.learn.output import write

    try:
        written = write(output, text, baseline)
    except OSError as error:
        return error
    for path in written:
        click.echo(f"phm learn: wrote {path}", err=True)
    return None


def _request(duration: str, containers: tuple[str, ...], folders: tuple[str, ...]) -> Any:
    from pydantic import TypeAdapter, ValidationError

    from phm.core.settings import Seconds
    from phm.learn.agent_observer import ObservationRequest, parse_folder

    try:
        for_s = float(TypeAdapter(Seconds).validate_python(duration))
    except (ValidationError, ValueError):
        for_s = 0.0
    if not 5 <= for_s <= 86400:
        raise click.UsageError(f"--for {duration}: must be a duration of 5s to 24h, such as 90s or 10min.")
    try:
        return ObservationRequest(for_s, containers, tuple(parse_folder(text) for text in folders))
    except ValueError as error:
        raise click.UsageError(f"--files {error}") from None


def _progress(text: str, seconds: float) -> None:
    click.echo(f"phm learn: {text}{f' for {seconds:g} s' if seconds else ''}", err=True)


def _print(old: str, new: str, name: str, baseline: Baseline, *, diff: bool, as_json: bool, printed: bool) -> None:
    from phm.learn.baseline_merger import unified_diff
    from phm.wire.text import one_line

    if as_json:
        click.echo(json.dumps(_document(old, new, baseline), indent=2))
    elif diff:
        colors = {"+": "green", "-": "red", "@": "cyan"}
        for line in unified_diff(old, new, name):
            click.echo(click.style(line, fg=colors.get(line[:1])))
    elif printed:
        click.echo(new, nl=False)
    for note in baseline.notes:
        click.echo(f"phm learn: {one_line(note)}", err=True)
    if unsure := baseline.unsure():
        click.echo(f"phm learn: {len(unsure)} settings are uncertain, see the comments `learned:`", err=True)


def _document(old: str, new: str, baseline: Baseline) -> dict[str, Any]:
    return {
        "changed": new != old,
        "containers": [entry.name for entry in baseline.containers],
        "nodes": [entry.name for entry in baseline.nodes],
        "topics": [entry.name for entry in baseline.topics],
        "manifests": {name: len(folder.files) for name, folder in baseline.manifests.items()},
        "unsure": [{"where": where, "why": why} for where, why in baseline.unsure()],
        "notes": list(baseline.notes),
        "configuration": new,
    }
