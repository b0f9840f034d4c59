"""Which calls PHM makes to the Docker Engine with a configuration: the allow-list, without a word of any proxy's language.

A container or network is a `CallSubject`: it may be called by its configured name, or by the id that the engine itself gave
for that name. What PHM does is in `phm.probes` and `phm.recovery.actions`; a call that is added there is added here.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterator
from dataclasses import dataclass

from phm.core.settings import ContainerSettings, FileSettings, Settings
from phm.probes.docker_event import FILTERS
from phm.probes.docker_processes import FORMS
from phm.probes.logs import TAIL
from phm.probes.volume_path import normal
from phm.transport import docker_bodies

COMMAND_LINES = "-ef"
"""Arguments for `ps` with which `relaunch` looks for its command (`phm.transport.docker.DockerEngine.top`)."""
STATISTICS = r"/stats\?stream=False&one-shot=True"
"""One reading, as `phm.transport.docker.DockerEngine.stats` asks for it."""
_ID_PREFIX = re.compile(r"[0-9a-f]{1,64}")
_ALIAS = r'"[A-Za-z0-9][A-Za-z0-9_.-]*"'
_ALIASES = rf'"Aliases": \[{_ALIAS}(?:, {_ALIAS})*\]'
_IPV4, _IPV6 = r'"IPv4Address": "[0-9.]+"', r'"IPv6Address": "[0-9A-Fa-f.:]+"'
_ADDRESS = rf'"IPAMConfig": \{{(?:{_IPV4}|{_IPV6}|{_IPV4}, {_IPV6})\}}'
_ENDPOINT = rf"\{{(?:{_ALIASES}|{_ADDRESS}|{_ALIASES}, {_ADDRESS})?\}}"


@dataclass(frozen=True, slots=True)
class CallSubject:
    """A container or network. key: names it among the rules."""

    kind: str
    name: str
    key: str


@dataclass(frozen=True, slots=True)
class AllowedCall:
    """One kind of call.

    path:    a regular expression of what follows the subject in path and query; without a subject, of all after the version.
    body:    a regular expression of the body; empty: there is none; None: any, an upload.
    learns:  the answer holds the id of the subject.
    starts:  the answer holds the id of a program in the subject, which may be started: `detached`, or `attached` and looked at.
    """

    why: str
    method: str
    path: str
    subject: CallSubject | None = None
    body: str | None = ""
    learns: bool = False
    starts: str = ""


def calls(settings: Settings) -> list[AllowedCall]:
    """All that PHM calls with these settings, which must have none of the `problems`."""
    me = CallSubject("containers", str(settings.docker.container), "me")
    made = [AllowedCall("events", "GET", r"/events" + exact(_events()) + r"(?:&since=[0-9.]+)?")]
    made += _container(me, "PHM itself")
    if settings.docker.unknown_containers.level != "off":
        made.append(AllowedCall("which containers run (docker.unknown_containers)", "GET", "/containers/json"))
    acted_on = [me.name]
    for number, entry in enumerate(settings.containers):
        subject = me if entry.name == me.name else CallSubject("containers", str(entry.name), f"c{number}")
        made += [*_container(subject, entry.key), *_reads(subject, entry, settings)]
        if entry.recover and settings.recovery.mode != "off":
            made += _actions(subject, entry, settings)
            acted_on.append(subject.name)
        if entry.key in settings.recovery.relieve and settings.recovery.mode != "off":
            weight = exact(docker_bodies.cpu_shares(0)).replace("0", "[0-9]{1,6}")
            made.append(AllowedCall(f"{entry.key}: its CPU weight", "POST", "/update", subject, weight))
    for number, name in enumerate(sorted({name for entry in settings.containers for name in entry.networks})):
        members = [entry.name for entry in settings.containers if name in entry.networks and entry.name in acted_on]
        made += _network(CallSubject("networks", name, f"n{number}"), [me.name, *map(str, members)])
    return made


def left_out(settings: Settings) -> list[str]:
    """What the configuration asks for and no rule allows, as sentences."""
    return [
        f"{entry.key}: restore of {file.path} from the image will be refused, because it needs to create a container: "
        "give the path of a golden copy"
        for entry in settings.containers
        for file in entry.files
        if file.restore == "image"
    ]


def problems(settings: Settings) -> Iterator[str]:
    """Why no exact rules can be made of these settings, and what to change."""
    if settings.docker.container is None:
        yield "docker.container: needed, so that the rules can name PHM's own container"
    for entry in settings.containers:
        if entry.name is None:
            yield f"containers: {entry.key} is known by a label, which rules cannot check: give its `name`"
    names = {"docker.container": [settings.docker.container], "name": [entry.name for entry in settings.containers]}
    names["networks"] = [name for entry in settings.containers for name in entry.networks]
    for key, values in names.items():
        for name in sorted({value for value in values if value and _ID_PREFIX.fullmatch(value)}):
            yield f"{key}: {name} could also be the beginning of an id: rename it, with a letter above f or a `-`"


def exact(text: str) -> str:
    """A regular expression that only this text matches. Less than `re.escape`: an auditor is to read the rules."""
    return re.sub(r"[.^$*+?{}\[\]\\|()]", r"\\\g<0>", text)


def _events() -> str:
    return docker_bodies.query({"filters": docker_bodies.filters(FILTERS)})


def _container(subject: CallSubject, title: str) -> list[AllowedCall]:
    return [AllowedCall(f"{title}: its state", "GET", "/json", subject, learns=True)]


def _reads(subject: CallSubject, entry: ContainerSettings, settings: Settings) -> Iterator[AllowedCall]:
    if entry.pressure != "ignore":
        # Used where the host's cgroups are not mounted into PHM, which the configuration does not show.
        yield AllowedCall(f"{entry.key}: its statistics", "GET", STATISTICS, subject)
    nodes = {settings.container_of_node(node.name) for node in settings.ros.nodes}
    topics = {settings.container_of_topic(topic) for topic in settings.ros.topics}
    listed = {check.container for check in settings.custom if check.type == "process"}
    if entry.key in nodes | topics | listed:
        forms = "|".join(exact(docker_bodies.query({"ps_args": form})) for form in (*FORMS, COMMAND_LINES))
        yield AllowedCall(f"{entry.key}: its processes", "GET", f"/top(?:{forms})", subject)
    yield from _own_checks(subject, entry, settings)
    for file in entry.files:
        yield AllowedCall(f"{entry.key}: is {_shown(file.path)} there", "HEAD", _archive(*_spellings(file)), subject)
        if file.present and file.sha256:
            yield AllowedCall(
                f"{entry.key}: content of {_shown(file.path)}", "GET", _archive(*_spellings(file)), subject
            )


def _own_checks(subject: CallSubject, entry: ContainerSettings, settings: Settings) -> Iterator[AllowedCall]:
    """The calls of the checks of `custom`."""
    for check in settings.custom:
        if check.type == "command" and check.container == entry.key:
            body = exact(docker_bodies.exec_attached(check.command))
            yield AllowedCall(f"{entry.key}: check {check.name}", "POST", "/exec", subject, body, starts="attached")
    if any(check.type == "log" and check.container == entry.key for check in settings.custom):
        query = exact(docker_bodies.query(docker_bodies.logs("SINCE", TAIL))).replace("SINCE", "[0-9.]+")
        yield AllowedCall(f"{entry.key}: its log", "GET", f"/logs{query}", subject)


def _actions(subject: CallSubject, entry: ContainerSettings, settings: Settings) -> Iterator[AllowedCall]:
    for verb, query in (("start", ""), ("unpause", ""), ("restart", r"(?:\?t=[0-9]{1,4})?")):
        yield AllowedCall(f"{entry.key}: {verb}", "POST", f"/{verb}{query}", subject)
    for node in settings.ros.nodes:
        if node.relaunch and settings.container_of_node(node.name) == entry.key:
            body = exact(docker_bodies.exec_(node.relaunch))
            yield AllowedCall(f"{entry.key}: relaunch {node.name}", "POST", "/exec", subject, body, starts="detached")
    for file in entry.files:
        if file.present and file.restore and file.restore != "image":
            folder = posixpath.dirname(posixpath.normpath(file.path))
            put = exact(docker_bodies.query(docker_bodies.upload(folder)))
            yield AllowedCall(f"{entry.key}: the folder of {_shown(file.path)}", "HEAD", _archive(folder), subject)
            yield AllowedCall(f"{entry.key}: restore {_shown(file.path)}", "PUT", f"/archive{put}", subject, body=None)


def _network(subject: CallSubject, members: list[str]) -> Iterator[AllowedCall]:
    yield AllowedCall(f"network {subject.name}", "GET", "", subject, learns=True)
    for name in members:
        off = "|".join(exact(docker_bodies.disconnect(name, force=force)) for force in (True, False))
        on = exact(docker_bodies.connect(name)).replace(r"\{\}\}", _ENDPOINT + r"\}")
        yield AllowedCall(f"network {subject.name}: disconnect {name}", "POST", "/disconnect", subject, f"(?:{off})")
        yield AllowedCall(f"network {subject.name}: connect {name}", "POST", "/connect", subject, on)


def _archive(*paths: str) -> str:
    return "/archive(?:" + "|".join(exact(docker_bodies.query({"path": path})) for path in paths) + ")"


def _spellings(file: FileSettings) -> list[str]:
    """As the check and the action write its path."""
    return sorted({normal(file.path), posixpath.normpath(file.path)})


def _shown(path: str) -> str:
    """A path for a comment of one line."""
    return ascii(path)[1:-1]
