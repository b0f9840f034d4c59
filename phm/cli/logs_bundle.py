"""`phm logs bundle`: one file for a report of a problem, without secrets. Implemented in `phm.logs`."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from phm.cli.hold import Duration
from phm.cli.options import config_option, run_dir_option

if TYPE_CHECKING:
    from phm.doctor.context import DoctorContext
    from phm.logs.bundle import Bundle
    from phm.logs.deadline import Deadline
    from phm.logs.secrets import Secrets

MOST_CONFIGURATION = 1_000_000
SHOWN = 40
SHARES = {
    "settings": 0.1,
    "MAVLink signing key": 0.15,
    "delivery key": 0.18,
    "phm.yaml": 0.2,
    "containers": 0.4,
    "versions.json": 0.45,
    "status.json": 0.5,
    "doctor.txt": 0.65,
}
"""The part of the time after which each is not waited for, in this order: one that hangs must not cost what comes after it."""
UNKNOWN_SECRETS = "its secrets are unknown and were not removed from the other files of the bundle"
T = TypeVar("T")


@click.command(epilog="Example: phm logs bundle problem.tar.gz")
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@config_option
@run_dir_option
@click.option(
    "--timeout",
    "timeout_s",
    metavar="TIME",
    type=Duration(),
    default="3min",
    show_default=True,
    help="Time limit; the output lists what was not collected by then.",
)
def bundle(file: Path, config: str | None, run_dir: str, timeout_s: float) -> None:
    """Write one file for a report of a problem, without secrets.

    FILE, a .tar.gz, must not exist. In it: logs, configuration, versions, status, the output of `phm doctor`, and logs and
    inspect output of the configured containers. What was removed is listed, and in REMOVED.txt. Exit code 0; 1: not written.
    """
    from phm.logs import bundle as made
    from phm.logs.deadline import Deadline
    from phm.logs.secrets import Secrets

    deadline = Deadline(timeout_s)
    known = _Known(_doctor_context(config, deadline), run_dir, Secrets(), deadline)
    known.learn(config)
    try:
        done = made.write(file, known.fill, known.secrets, deadline)
    except OSError as error:
        raise click.ClickException(f"cannot write {file}: {error.strerror}") from None
    _show(file, done)


def _doctor_context(config: str | None, deadline: Deadline) -> DoctorContext:
    """With the defaults where the configuration cannot be read in time."""
    from phm.cli.doctor import doctor_context
    from phm.core.settings import Settings
    from phm.doctor.context import DoctorContext
    from phm.logs.deadline import Late

    try:
        return deadline.within(SHARES["settings"], lambda: doctor_context(config))
    except Late as error:
        return DoctorContext(Settings(), problem=f"the configuration: {error}")


@dataclass
class _Known:
    """What is looked at before anything is written, because each part may name secrets of the others."""

    doctor_context: DoctorContext
    run_dir: str
    secrets: Secrets
    deadline: Deadline
    configuration: str | None = None
    containers: dict[str, tuple[str, Any]] = field(default_factory=dict)
    missing: list[tuple[str, str]] = field(default_factory=list)

    def learn(self, config: str | None) -> None:
        settings = self.doctor_context.settings
        self.secrets.learn_environment((f"{name}={value}" for name, value in os.environ.items()), "environment")
        for url in settings.notify.urls:
            self.secrets.learn_url(url, "URL of notify.urls")
        self._key(settings.mavlink.signing.key, "MAVLink signing key")
        self._key(settings.delivery.key, "delivery key")
        self._configuration(config)
        self._containers()

    def _key(self, path: str | None, what: str) -> None:
        """A key as in its file, which may have hexadecimal digits of either case, and in such digits. what: its name, in SHARES."""
        from phm.logs.deadline import Late

        try:
            data = self.deadline.within(SHARES[what], lambda: _read(Path(path), 4096)) if path else b""
        except (OSError, Late) as error:
            why = error.strerror if isinstance(error, OSError) else error
            self.missing.append((what, f"{path}: {why}; {UNKNOWN_SECRETS}"))
            return
        for text in (data.hex(), data.decode("latin-1").strip()):
            for spelled in dict.fromkeys((text, text.lower(), text.upper())):
                self.secrets.learn(spelled, what)

    def _configuration(self, config: str | None) -> None:
        import yaml

        from phm.config import find
        from phm.logs.deadline import Late

        path = find(config)
        try:
            text = self.deadline.within(SHARES["phm.yaml"], lambda: _read(path, MOST_CONFIGURATION + 1)).decode("utf-8")
            if len(text) > MOST_CONFIGURATION:
                raise ValueError(f"larger than {MOST_CONFIGURATION} bytes")
            tree = yaml.safe_load(text)
        except Late as error:
            self.missing.append(("phm.yaml", f"{path}: {error}; {UNKNOWN_SECRETS}"))
            return
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
        from phm.logs.deadline import Late

        engine = self.doctor_context.engine
        for container in self.doctor_context.settings.containers:
            try:
                ref, inspected = self.deadline.within(
                    SHARES["containers"], partial(containers.inspected, engine, container)
                )
            except (CannotTell, Late) as error:
                why = f"{error}; {UNKNOWN_SECRETS}"
                self.missing.append((f"container {container.key}", why))
                continue
            self.secrets.learn_environment(containers.environment(inspected), f"container {container.key}")
            self.secrets.learn_tree(inspected, f"container {container.key}")
            self.containers[container.key] = (ref, inspected)

    # ------------------------------------------------------------ writing

    def fill(self, target: Bundle) -> None:
        from phm.logs import bundle as made

        target.missing += self.missing
        if self.configuration is not None:
            target.text("phm.yaml", self.configuration, urls=True)
        self._part("versions.json", _versions, lambda found: target.tree("versions.json", found), target)
        environ = made.chosen(os.environ)
        target.tree("environment.json", [f"{name}={value}" for name, value in environ.items()])
        self._status(target)
        self._part(
            "doctor.txt",
            lambda: _doctor(self.doctor_context, self.deadline.left(SHARES["doctor.txt"])),
            lambda text: target.text("doctor.txt", text, urls=True),
            target,
        )
        for key, (_, inspected) in self.containers.items():
            target.tree(f"containers/{made.file_name(key)}/inspect.json", inspected)
        target.logs(Path(self.doctor_context.settings.log.directory))
        for key, (ref, _) in self.containers.items():
            self._container_log(key, ref, target)

    def _status(self, target: Bundle) -> None:
        from phm.wire import status_file

        self._part(
            "status.json",
            lambda: status_file.read(self.run_dir),
            lambda found: target.tree("status.json", found),
            target,
        )

    def _container_log(self, key: str, ref: str, target: Bundle) -> None:
        from phm.logs import bundle as made, containers

        self._part(
            f"log of container {key}",
            lambda: containers.log(self.doctor_context.engine, ref),
            lambda text: target.text(f"containers/{made.file_name(key)}/log.txt", text),
            target,
        )

    def _part(self, what: str, get: Callable[[], T], add: Callable[[T], None], target: Bundle) -> None:
        """Get it in its share of the time, and add it; or list why it is not there."""
        from phm.facts import CannotTell
        from phm.logs.deadline import Late
        from phm.wire.status_file import NoStatus

        try:
            found = self.deadline.within(SHARES.get(what, 1.0), get)
        except (CannotTell, Late, NoStatus, OSError) as error:
            target.missing.append((what, str(error)))
            return
        add(found)


def _read(path: Path, most: int) -> bytes:
    with open(path, "rb") as stream:
        return stream.read(most)


def _versions() -> dict[str, Any]:
    from importlib.metadata import distributions

    from phm import __version__

    packages = sorted({f"{each.metadata['Name']} {each.version}" for each in distributions()})
    system = {"system": platform.platform(), "machine": platform.machine(), "python": platform.python_version()}
    return {"phm": __version__, **system, "packages": packages[:1000]}


def _doctor(doctor_context: DoctorContext, limit_s: float) -> str:
    from phm.doctor.examination import LIMIT_S, examine

    lines = []
    # A second less: what the other groups found is there although one hangs.
    for group, rows in examine(doctor_context, limit_s=min(LIMIT_S, max(0.1, limit_s - 1.0, limit_s / 2))).items():
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
    click.echo(one_line(f"written: {file}; read it before you send it"))
