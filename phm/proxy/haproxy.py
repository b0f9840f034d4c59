"""The allow-list as a configuration file of HAProxy 2.4 or later. Pure: settings in, text out.

Ids are learned: when the engine answers about a configured *name*, the id in its answer is kept in a variable of the
process, and from then on that id is accepted for the name. A call by any other id is refused.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from phm.core.settings import Settings
from phm.proxy.calls import AllowedCall, CallSubject, calls, exact, problems
from phm.transport import docker_bodies

_VERSION = r"/v1\.(?:2[4-9]|[3-9][0-9])"
"""Before 1.24, `start` took a body with mounts and privileges."""
_REF = "[A-Za-z0-9][A-Za-z0-9_.-]*"
_PLAIN = re.compile(r"/[A-Za-z0-9._/-]+")
_REFUSAL = '{"message": "the socket proxy allows only the calls that `phm proxy-rules` derived from the configuration"}'
_VARIABLES = {"detached": "x", "attached": "y"}
"""Beginnings of the names of variables with the id of the newest program in a container, by how it is started."""
_SILENCE_S = 600
"""Longer than PHM waits for any answer, and than an event stream may be silent."""
_HEAD = """\
# Made by `phm proxy-rules` for {agent}: the calls that PHM makes with its configuration, and no other.
global
    nbthread 1
    maxconn 64
    log stdout format raw local0

defaults
    mode http
    log global
    # %ST: without it the line would be written before the rules are asked.
    log-format "%ST %HM %HU"
    timeout connect 5s
    timeout http-request 5s
    timeout client {silence}s
    timeout server {silence}s
    option http-no-delay
    option abortonclose

frontend phm
    bind unix@{socket} mode 660
    option http-buffer-request
    # What is called: the part of the path after /v1.NN/containers/, /v1.NN/networks/ or /v1.NN/exec/.
    http-request set-var(txn.ref) path,field(4,/)
    # A text ends at its first NUL: what is compared must be the whole body.
    http-request set-var(txn.length) req.body,lower,length
    acl empty req.body_size eq 0
    acl whole req.body_size,sub(txn.length) eq 0
    acl chunked req.hdr_cnt(transfer-encoding) gt 0
    # After an upgrade the engine reads a stream that the rules do not see; PHM never asks for one.
    acl upgrade req.fhdr(upgrade) -m found
    acl upgrade req.fhdr(connection) -m sub -i upgrade
    http-request deny deny_status 403 content-type application/json string {refusal} if upgrade
"""
_TAIL = """\
    http-request set-log-level notice
    http-request deny deny_status 403 content-type application/json string {refusal}
    default_backend engine

backend engine
    http-response wait-for-body time 2s at-least 512 if {{ var(txn.learn) -m found }}
{learned}    server engine unix@{engine}
"""


class NoRules(ValueError):
    """The configuration does not allow exact rules; each of `problems` says what to change."""

    def __init__(self, problems: list[str]) -> None:
        super().__init__("; ".join(problems))
        self.problems = problems


def rules(settings: Settings, engine: str) -> str:
    """The text of haproxy.cfg. engine: path of the engine's own socket. Raises NoRules.

    PHM calls at `docker.socket` of the settings, which must be another unix socket.
    """
    found = [*_sockets(settings.docker.socket, engine), *problems(settings)]
    if found:
        raise NoRules(found)
    made = calls(settings)
    subjects = list(dict.fromkeys(call.subject for call in made if call.subject is not None))
    frontend = [*_subjects(subjects), *_fixed()]
    for call in made:
        frontend += _call(call)
    for kind, key in _starting(made):
        frontend += _start_exec(kind, key)
    learned = "".join(f"    {line}\n" for line in _learned(made))
    refusal = quoted(_REFUSAL)
    socket = settings.docker.socket.removeprefix("unix://")
    head = _HEAD.format(agent=settings.agent.name, silence=_SILENCE_S, socket=socket, refusal=refusal)
    tail = _TAIL.format(refusal=refusal, learned=learned, engine=engine)
    return head + "".join(f"    {line}\n" for line in frontend) + tail


def _sockets(listen: str, engine: str) -> Iterator[str]:
    """What is wrong with where PHM calls."""
    path = listen.removeprefix("unix://")
    if path in (listen, engine):
        yield f"docker.socket: {listen} must be the proxy's own unix socket, e.g. unix:///run/phm-engine/docker.sock"
    for name in (path, engine):
        if not _PLAIN.fullmatch(name):
            yield f"docker.socket: {name!a} must be a path of letters, digits, `.`, `_`, `-` and `/` for the rules"


def quoted(text: str) -> str:
    """One word of the file, whatever characters it has: in strong quotes nothing has a meaning but their end."""
    return "'" + text.replace("'", r"'\''") + "'"


def _subjects(subjects: list[CallSubject]) -> Iterator[str]:
    """`on_KEY`: the call is about that container or network. `named_KEY`: by its name."""
    for subject in subjects:
        yield f"acl named_{subject.key} var(txn.ref) -m str {subject.name}"
        yield f"acl on_{subject.key} var(txn.ref) -m str {subject.name}"
        yield f"acl on_{subject.key} var(txn.ref),strcmp(proc.{subject.key}) eq 0"


def _fixed() -> Iterator[str]:
    yield "http-request set-log-level silent"
    yield "# Of the engine itself"
    yield _when("allow", "GET", "/version", "empty !chunked")


def _call(call: AllowedCall) -> Iterator[str]:
    subject = call.subject
    path = f"/{subject.kind}/{_REF}{call.path}" if subject is not None else call.path
    words = [f"on_{subject.key}"] if subject is not None else []
    if call.body is not None:
        words += ["!chunked", "empty" if not call.body else f"whole {{ req.body -m reg {quoted(f'^{call.body}$')} }}"]
    condition = " ".join(words)
    yield f"# {call.why}"
    if call.learns and subject is not None:
        yield _when(
            f"set-var(txn.learn) str({subject.key})", "GET", _VERSION + path, f"{condition} named_{subject.key}"
        )
    if call.starts and subject is not None:
        yield _when(
            f"set-var(txn.learn) str({_VARIABLES[call.starts]}{subject.key})", "POST", _VERSION + path, condition
        )
    yield _allow(call.method, _VERSION + path, condition)


def _starting(made: list[AllowedCall]) -> list[tuple[str, str]]:
    """How programs are started, and the keys of the containers in which they are."""
    return list(dict.fromkeys((call.starts, call.subject.key) for call in made if call.starts and call.subject))


def _start_exec(kind: str, key: str) -> Iterator[str]:
    yield "# Start what was made just now"
    variable = f"{_VARIABLES[kind]}{key}"
    yield f"acl made_{variable} var(txn.ref),strcmp(proc.{variable}) eq 0"
    body = exact(docker_bodies.START_ATTACHED if kind == "attached" else docker_bodies.START_EXEC)
    condition = f"made_{variable} !chunked whole {{ req.body -m reg {quoted(f'^{body}$')} }}"
    yield _allow("POST", f"{_VERSION}/exec/[0-9a-f]+/start", condition)
    if kind == "attached":
        yield _allow("GET", f"{_VERSION}/exec/[0-9a-f]+/json", f"made_{variable} empty !chunked")


def _allow(method: str, path: str, condition: str) -> str:
    return _when("allow", method, path, condition)


def _when(rule: str, method: str, path: str, condition: str) -> str:
    return f"http-request {rule} if {{ method {method} }} {{ pathq -m reg {quoted(f'^{path}$')} }} {condition}"


def _learned(made: list[AllowedCall]) -> Iterator[str]:
    """What the engine's answers say about ids; a name that it does not know has none any more."""
    for key in dict.fromkeys(call.subject.key for call in made if call.learns and call.subject is not None):
        about = f"{{ var(txn.learn) -m str {key} }}"
        yield f"http-response set-var(proc.{key}) res.body,json_query('$.Id') if {about} {{ status 200 }}"
        yield f"http-response unset-var(proc.{key}) if {about} {{ status 404 }}"
    for kind, key in _starting(made):
        variable = f"{_VARIABLES[kind]}{key}"
        about = f"{{ var(txn.learn) -m str {variable} }}"
        yield f"http-response set-var(proc.{variable}) res.body,json_query('$.Id') if {about} {{ status 201 }}"
