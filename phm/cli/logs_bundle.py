"""`phm logs bundle`: one file for a report of a problem, without secrets. Implemented in `phm.logs`."""

from __future__ import annotations

import os
import platform
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from phm.cli.options import config_option, run_dir_option

if TYPE_CHECKING:
    from phm.doctor.context import Surroundings
    from phm.logs.bundle import Bundle
    from phm.logs.secrets import Secrets

MOST_CONFIGURATION = 1_000_000
SHOWN = 40


@click.command(epilog="Example: phm logs bundle problem.tar.gz")
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@config_option
@run_dir_option
def bundle(file: Path, config: str | None, run_dir: str) -> None:
    """Write one file for a report of a problem, without secrets.

    FILE, a .tar.gz, must not exist. In it: logs, configuration, versions, status, the output of `phm doctor`, and logs and
    inspect output of the configured containers. What was removed is listed, and in REMOVED.txt. Exit code 0; 1: not written.
    """
    from phm.cli.doctor import surroundings
    from phm.logs import bundle as made
    from phm.logs.secrets import Secrets

    known = _Known(surroundings(config), run_dir, Secrets())
    known.look(config)
    try:
        done = made.write(file, known.fill, known.secrets)
    except OSError as error:
        raise click.ClickException(f"cannot write {file}: {error.strerror}") from None
    _show(file, done)


@dataclass
class _Known:
    """What is looked at before anything is written, because each part may name secrets of the others."""

    surroundings: Surroundings
    run_dir: str
    secrets: Secrets
    configuration: str | None = None
    containers: dict[str, tuple[str, Any]] = field(default_factory=dict)
    missing: list[tuple[str, str]] = field(default_factory=list)

    def look(self, config: str | None) -> None:
        settings = self.surroundings.settings
        self.secrets.learn_environment((f"{name}={value}" for name, value in os.environ.items()), "environment")
        for url in settings.notify.urls:
            self.secrets.learn_url(url, "URL of notify.urls")
        self._key(settings.mavlink.signing.key)
        self._configuration(config)
        self._containers()

    def _key(self, path: str | None) -> None:
        """The signing key, as it is in its file, in hexadecimal digits, and as text."""
        try:
            data = Path(path).read_bytes()[:4096] if path else b""
        except OSError:
            return
        what = "MAVLink signing key"
        for text in (data.hex(), data.hex().upper(), data.decode("latin-1").strip()):
            self.secrets.learn(text, what)

    def _configuration(self, config: str | None) -> None:
        import yaml

        from phm.config import find

        path = find(config)
        try:
            with open(path, encoding="utf-8") as stream:
                text = stream.read(MOST_CONFIGURATION + 1)
            if len(text) > MOST_CONFIGURATION:
                raise ValueError(f"larger than {MOST_CONFIGURATION} bytes")
            tree = yaml.safe_load(text)
        except (OSError, ValueError, RecursionError, yaml.YAMLError) as error:
            # Without its structure, values of several lines cannot be found.
            self.missing.append(
                ("phm.yaml", f"{path} cannot be read as YAML ({type(error).__name__}): see phm validate")
            )
            return
        self.secrets.learn_tree(tree, "phm.yaml")
        notify = tree.get("notify") if isinstance(tree, dict) else None
        urls = notify.get("urls") if isinstance(notify, dict) else None
        for url in urls if isinstance(urls, list) else ():
            self.secrets.learn_url(str(url), "URL of notify.urls")
        self.configuration = text

    def _containers(self) -> None:
        from phm.facts import CannotTell
        from phm.logs import containers

        engine = self.surroundings.engine
        for container in self.surroundings.settings.containers:
            try:
                ref = containers.reference(engine, container)
                inspected = engine.inspect(ref, deadline_s=containers.DEADLINE_S)
            except CannotTell as error:
                self.missing.append((f"container {container.key}", str(error)))
                continue
            self.secrets.learn_environment(containers.environment(inspected), f"container {container.key}")
            self.secrets.learn_tree(inspected, f"container {container.key}")
            self.containers[container.key] = (ref, inspected)

    # ------------------------------------------------------------ writing

    def fill(self, target: Bundle) -> None:
        from phm.facts import CannotTell
        from phm.logs import bundle as made, containers

        target.missing += self.missing
        if self.configuration is not None:
            target.text("phm.yaml", self.configuration, urls=True)
        target.tree("versions.json", _versions())
        environ = made.chosen(os.environ)
        target.tree("environment.json", [f"{name}={value}" for name, value in environ.items()])
        self._status(target)
        target.text("doctor.txt", _doctor(self.surroundings), urls=True)
        for key, (ref, inspected) in self.containers.items():
            folder = f"containers/{made.file_name(key)}"
            target.tree(f"{folder}/inspect.json", inspected)
            try:
                target.text(f"{folder}/log.txt", containers.log(self.surroundings.engine, ref))
            except CannotTell as error:
                target.missing.append((f"log of container {key}", str(error)))
        target.logs(Path(self.surroundings.settings.log.directory))

    def _status(self, target: Bundle) -> None:
        from phm.wire import status_file

        try:
            target.tree("status.json", status_file.read(self.run_dir))
        except status_file.NoStatus as error:
            target.missing.append(("status.json", str(error)))


def _versions() -> dict[str, Any]:
    from importlib.metadata import distributions

    from phm import __version__

    packages = sorted({f"{each.metadata['Name']} {each.version}" for each in distributions()})
    system = {"system": platform.platform(), "machine": platform.machine(), "python": platform.python_version()}
    return {"phm": __version__, **system, "packages": packages[:1000]}


def _doctor(surroundings: Surroundings) -> str:
    from phm.doctor.examination import examine

    lines = []
    for group, rows in examine(surroundings).items():
        for row in map(asdict, rows):
            remedy = f" -> {row['remedy']}" if row["remedy"] else ""
            lines.append(f"{group}: {row['name']}: {row['state']}: {row['text']}{remedy}")
    return "\n".join(lines) + "\n"


def _show(file: Path, done: Bundle) -> None:
    from phm.wire.text import one_line

    for name, size in done.written:
        click.echo(one_line(f"{size:>11} bytes  {name}"))
    for what, why in done.missing:
        click.echo(one_line(f"not in it: {what}: {done.secrets.clean(why, 'terminal')}"))
    removed = done.removed()
    for line in removed[:SHOWN]:
        click.echo(one_line(f"removed: {line}"))
    if len(removed) > SHOWN:
        click.echo(f"removed: {len(removed) - SHOWN} more, see REMOVED.txt in the bundle")
    click.echo(one_line(f"written: {file}; look through it before you send it"))
