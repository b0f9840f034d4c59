"""The Docker Engine, and what PHM may do there."""

from __future__ import annotations

from collections.abc import Iterator

from phm.doctor.context import DoctorContext
from phm.doctor.row import Row, limited, missing, ok
from phm.facts import CannotTell, ContainerFact, NotPermitted
from phm.probes.docker_facts import container_fact
from phm.transport.docker import EngineMissing

OLDEST_API = (1, 41)
"""The API version of Docker 20.10."""
_PROXY = "make its rules with `phm proxy-rules`, or allow GET of /version: docs/reference/security.md"
_LISTING = "not needed behind PHM's own proxy: only `phm init` and `phm learn` use the list"


def rows(context: DoctorContext) -> Iterator[Row]:
    engine = context.engine
    try:
        version = engine.version()
    except NotPermitted as error:
        yield limited("version", str(error), _PROXY)
    except CannotTell as error:
        yield missing("version", *_remedied(str(error)))
        return
    else:
        yield _version(str(version.get("Version") or "of unknown version"), str(version.get("ApiVersion") or ""))
    try:
        machine = context.machine()
    except NotPermitted as error:
        yield limited("rights", str(error), _LISTING)
        yield from _configured(context)
        return
    except CannotTell as error:
        yield missing("rights", *_remedied(str(error)))
        return
    running = [one.name for one in machine.applications if one.fact.running]
    yield ok("rights", "PHM may list and inspect containers")
    yield ok("containers", f"{len(running)} running: {', '.join(running)}" if running else "no application is running")
    yield from _configured(context)


def _version(version: str, api: str) -> Row:
    numbers = tuple(int(part) for part in api.split(".") if part.isdecimal())
    text = f"Docker Engine {version}, API {api or 'unknown'}"
    if numbers and numbers < OLDEST_API:
        return limited("version", text, "update Docker to 20.10 or later")
    return ok("version", text)


def _configured(context: DoctorContext) -> Iterator[Row]:
    """Looked up as by the daemon, by the name of the container alone."""
    for entry in context.settings.containers:
        if not entry.name:
            continue
        row = f"container {entry.key}"
        try:
            fact = _container(context, entry.name)
        except CannotTell as error:
            yield limited(row, *_remedied(str(error)))
            continue
        if fact is None:
            yield missing(
                row, f"container {entry.name} of the configuration does not exist", _name(context, entry.name)
            )
        elif fact.status not in ("running", "paused"):
            yield limited(row, f"container {entry.name} is {fact.status}", f"start it: docker start {entry.name}")


def _container(context: DoctorContext, name: str) -> ContainerFact | None:
    try:
        fact = container_fact(context.engine.inspect(name))
    except EngineMissing:
        return None
    return fact if fact.name == name else None  # the engine finds it by a part of its id, too


def _name(context: DoctorContext, wanted: str) -> str:
    """What to do about a name that no container has."""
    try:
        applications = context.machine().applications
    except CannotTell:
        applications = ()
    same = [one.name for one in applications if one.service == wanted]
    if same:
        return f"{wanted} is a Compose service: use the name of its container, {' or '.join(same)}"
    return "start it, or correct its name: `docker ps --all` lists the names"


def _remedied(text: str) -> tuple[str, str]:
    """The sentence of an error of the engine, and its last part, which says what to do."""
    what, _, remedy = text.rpartition(": ")
    return (what, remedy) if what else (text, "see `docker version`")
