"""`phm logs collect`: the logs of all agents that can be reached, in one folder. Implemented in `phm.logs`."""

from __future__ import annotations

import contextlib
import json
import os
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from phm.cli.options import json_option
from phm.wire.text import one_line

if TYPE_CHECKING:
    from phm.logs.log_collection import CollectedLogs, Collection
    from phm.logs.log_copier import Progress
    from phm.logs.log_sources import LogSearchResult

ENGINE = "unix:///var/run/docker.sock"
NAME_AGENTS = "or name the agents: --docker ssh://USER@HOST, or a folder"
AT_ONCE = 8
"""Engines that are asked at the same time: one that does not answer takes its deadline."""
SHOWN = 200


class _Engine(click.ParamType):  # type: ignore[type-arg]
    """The address of a Docker Engine."""

    name = "url"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from urllib.parse import urlsplit

        from phm.transport.docker_http import ssh_command

        url = str(value).strip()
        try:
            parts = urlsplit(url)
            if parts.scheme == "ssh":
                ssh_command(url)
            local = parts.scheme == "unix" and not parts.netloc and parts.path.startswith("/")
            # The port is looked at, because it is checked only then.
            if not local and (parts.scheme not in ("tcp", "ssh") or not parts.hostname or parts.port == 0):
                raise ValueError("unknown form")
        except ValueError as error:
            why = f"{url!r} is not the address of a Docker Engine: {error}"
            self.fail(f"{why}; write unix:///PATH, tcp://HOST:PORT or ssh://USER@HOST", param, ctx)
        return url


@click.command(epilog="Example: phm logs collect logs/ --docker ssh://pi@drone1")
@click.argument("folder", metavar="DIR", type=click.Path(file_okay=False, path_type=Path))
@click.argument("paths", metavar="[PATH]...", nargs=-1, type=click.Path(path_type=Path))
@click.option(
    "--docker",
    "engines",
    metavar="URL",
    multiple=True,
    type=_Engine(),
    help="A Docker Engine: unix:///PATH, tcp://HOST:PORT, ssh://USER@HOST; repeatable.  [default: DOCKER_HOST, else this "
    "computer's, unless a PATH is given]",
)
@click.option(
    "--container", "patterns", metavar="GLOB", multiple=True, help="Only containers with a matching name; repeatable."
)
@click.option("--path", "place", default="/var/log/phm", show_default=True, help="Folder of the log in the containers.")
@json_option
def collect(
    folder: Path,
    paths: tuple[Path, ...],
    engines: tuple[str, ...],
    patterns: tuple[str, ...],
    place: str,
    as_json: bool,
) -> None:
    """Copy the logs of all agents that can be reached into one folder.

    DIR gets a folder for each agent; `phm report DIR` and `phm logs DIR` read it. Of a Docker Engine the logs of all containers
    that have some are copied. PATH is a folder with logs, such as that of a mounted card. The next run into the same DIR
    fetches what is new, and removes nothing. Exit code 0; 1: something is missing (it is listed, the rest is there).
    """
    from phm.logs.log_collection import Collection, InUse

    if not place.startswith("/"):
        raise click.UsageError(f"--path {place} is not an absolute path, such as /var/log/phm")
    if inside := [path for path in paths if folder.resolve() in (path.resolve(), *path.resolve().parents)]:
        raise click.UsageError(f"{inside[0]} is in {folder}, into which the logs are collected: name another folder")
    if not engines and not paths:
        engines = (_Engine().convert(os.environ.get("DOCKER_HOST") or ENGINE, None, None),)
    collection = Collection(folder)
    try:
        with collection.open():
            done, missing = _run(collection, tuple(dict.fromkeys(engines)), paths, patterns, place)
    except InUse as error:
        raise click.ClickException(str(error)) from None
    except OSError as error:
        raise click.ClickException(f"cannot write {folder}: {error.strerror or error}") from None
    missing += [(one.source, f"{what}: {why}") for one in done for what, why in one.missing]
    if as_json:
        logs = [{key: value for key, value in asdict(one).items() if key != "missing"} for one in done if one.folder]
        lost = [{"what": what, "why": why} for what, why in missing]
        click.echo(json.dumps({"folder": str(folder), "logs": logs, "missing": lost}, separators=(",", ":")))
    else:
        _show(folder, done, missing)
    raise click.exceptions.Exit(1 if missing else 0)


def _run(
    collection: Collection, engines: Sequence[str], paths: Sequence[Path], patterns: Sequence[str], place: str
) -> tuple[list[CollectedLogs], list[tuple[str, str]]]:
    """All outcomes, and what was looked for in vain: (what, why)."""
    from phm.facts import CannotTell
    from phm.logs import log_sources
    from phm.transport.docker import DockerEngine, EngineNotConnected

    missing: list[tuple[str, str]] = []
    opened: list[DockerEngine] = []

    def copied(result: LogSearchResult) -> list[CollectedLogs]:
        missing.extend(result.missing)
        return [collection.take(source, bar) for source in result.found]

    def of_engine(url: str) -> list[CollectedLogs]:
        engine = DockerEngine(url, log_sources.ANSWER_S)
        opened.append(engine)
        try:
            return copied(log_sources.of_engine(engine, place, patterns))
        except CannotTell as error:
            # As on a ground computer, whose agents are elsewhere.
            elsewhere = isinstance(error, EngineNotConnected) and url == ENGINE
            missing.append((url, f"{error}; {NAME_AGENTS}" if elsewhere else str(error)))
            return []
        finally:
            engine.close()

    with _progress() as bar, ThreadPoolExecutor(AT_ONCE) as pool:
        try:
            done = [one for some in pool.map(of_engine, engines) for one in some]
            for path in paths:
                done += copied(log_sources.of_path(path, collection.folder))
        except BaseException:  # Ctrl-C, a full disk: the other calls end now
            for engine in opened:
                engine.close()
            raise
    return done, missing


@contextlib.contextmanager
def _progress() -> Iterator[Progress]:
    """A bar on a terminal; Ctrl-C ends the run, and the next one goes on."""
    from rich import progress
    from rich.console import Console

    columns = (
        *(progress.TextColumn("collecting"), progress.BarColumn(), progress.DownloadColumn()),
        *(progress.TransferSpeedColumn(), progress.TimeRemainingColumn()),
    )
    console = Console(stderr=True)
    with progress.Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as shown:
        yield _Bar(shown)


class _Bar:
    def __init__(self, shown: Any) -> None:
        self._shown, self._task = shown, shown.add_task("collecting", total=0)
        self._lock, self._total = threading.Lock(), 0

    def expect(self, count: int) -> None:
        with self._lock:
            self._total += count
            self._shown.update(self._task, total=self._total)

    def advance(self, count: int) -> None:
        self._shown.advance(self._task, count)


def _show(folder: Path, done: Sequence[CollectedLogs], missing: Sequence[tuple[str, str]]) -> None:
    for one in done:
        if one.folder:
            files = "1 file" if one.fetched == 1 else f"{one.fetched} files"
            size = f"{one.bytes / 1e6:.1f} MB"
            said = f"{files} fetched ({size}), {one.unchanged} unchanged"
            click.echo(one_line(f"{folder / one.folder}: {said}; from {one.source}"))
    for what, why in missing[:SHOWN]:
        click.echo(one_line(f"missing: {what}: {why}"), err=True)
    if len(missing) > SHOWN:
        click.echo(f"missing: {len(missing) - SHOWN} more, see --json", err=True)
