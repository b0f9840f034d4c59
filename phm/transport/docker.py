"""Calls to the Docker Engine through docker-py, with a wall-clock deadline for each.

The probes and the recovery actions use one `DockerEngine`. The calls are here; deadlines, clients and errors are in
`phm.transport.docker_session`, calls about files in `phm.transport.docker_files`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any
from urllib.parse import quote

from docker import APIClient
from requests.models import Response

from phm.transport import docker_bodies, docker_frames
from phm.transport.docker_errors import (
    EngineBroken,
    EngineConflict,
    EngineError,
    EngineMissing,
    EngineNotConnected,
    EngineRefused,
    EngineTimeout,
    EngineUnreachable,
    translate,
)
from phm.transport.docker_files import DockerFiles
from phm.transport.docker_http import EventStream
from phm.transport.docker_session import FAILURES, Answer, mapping, raise_for_status
from phm.transport.docker_tar import FileCopy

__all__ = [
    "DockerEngine",
    "EngineBroken",
    "EngineConflict",
    "EngineError",
    "EngineMissing",
    "EngineNotConnected",
    "EngineRefused",
    "EngineTimeout",
    "EngineUnreachable",
    "EventStream",
    "FileCopy",
]

NEVER_STARTED = -1
"""In the place of the exit code of a program."""
NOT_MODIFIED = 304
"""The engine's status code if a container is already in the requested state."""
EVENT_SILENCE_S = 60.0
"""An event stream silent for longer is closed, so that a half-open TCP connection ends."""


class DockerEngine(DockerFiles):
    """The engine at `url` (``unix:///path``, ``tcp://host:port``, ``ssh://user@host``). Thread-safe; nothing is opened here.

    Every method raises a subclass of `EngineError` (itself a `phm.facts.CannotTell`): EngineTimeout,
    EngineUnreachable, EngineRefused (403; also NotPermitted), EngineConflict (409), EngineMissing (404),
    EngineBroken. Containers and networks are named by id or name.
    """

    # ------------------------------------------------------------ asking

    def version(self) -> Answer:
        """GET /version: Version, ApiVersion, MinAPIVersion, ..."""
        return self._ask(lambda client: client.version(api_version=False), None, "read its version")

    def list(self, *, label: str = "", deadline_s: float | None = None) -> Sequence[Answer]:
        """Summaries of all containers, including stopped ones; with `label` only those that have it."""
        filters = {"label": [label]} if label else None

        def ask(client: APIClient) -> Sequence[Answer]:
            return [mapping(entry) for entry in client.containers(all=True, filters=filters)]

        return self.call(ask, deadline_s=deadline_s, what="list containers")

    def running(self) -> Sequence[Answer]:
        """Summaries of the running containers."""

        def ask(client: APIClient) -> Sequence[Answer]:
            response = client.get(f"{client.base_url}/v{client.api_version}/containers/json", timeout=client.timeout)
            raise_for_status(response)
            return [mapping(entry) for entry in response.json()]

        return self.call(ask, what="list running containers")

    def inspect(self, ref: str, *, deadline_s: float | None = None) -> Answer:
        """All data of one container."""
        return self._ask(lambda client: client.inspect_container(ref), deadline_s, f"inspect {ref}")

    def inspect_network(self, ref: str, *, deadline_s: float | None = None) -> Answer:
        """All data of one network."""
        return self._ask(lambda client: client.inspect_network(ref), deadline_s, f"inspect network {ref}")

    def top(self, container: str, ps_args: str = "-ef", *, deadline_s: float | None = None) -> Answer:
        """The processes of a running container: Titles and Processes, in the format of the host's `ps`."""
        what = f"list processes of {container}"
        return self._ask(lambda client: client.top(container, ps_args=ps_args), deadline_s, what)

    def stats(self, container: str, *, deadline_s: float | None = None) -> Answer:
        """A single reading of a container's use of CPU, memory and processes since its start.

        Current engines respond immediately; 20.10 only at the next tick of its collector, after up to 1 s.
        """
        what = f"read the statistics of {container}"
        return self._ask(lambda client: client.stats(container, stream=False, one_shot=True), deadline_s, what)

    def _ask(self, fn: Callable[[APIClient], Any], deadline_s: float | None, what: str) -> Answer:
        """One JSON object; anything else is invalid, EngineBroken."""
        return self.call(lambda client: mapping(fn(client)), deadline_s=deadline_s, what=what)

    def events(self, since: str = "", filters: Mapping[str, Sequence[str]] | None = None) -> EventStream:
        """Open the stream of events; iterate over it in this thread, `close` it from any.

        `since`: seconds of the engine's clock, with nanoseconds after the point; empty for now. The iteration ends when
        the engine ends the stream or after `close`. It raises EngineError when the stream breaks or is silent for
        EVENT_SILENCE_S; the caller reconnects.
        """
        params = {"filters": docker_bodies.filters(filters or {})}
        if since:
            params["since"] = since
        with self.calling("follow events", None) as (client, call):
            url = f"{client.base_url}/v{client.api_version}/events"
            response = client.get(url, params=params, stream=True, timeout=(client.timeout, EVENT_SILENCE_S))
            raise_for_status(response)
            sockets = call.finish()
        explain = partial(translate, call=call, url=self.url, limit_s=EVENT_SILENCE_S, what="follow events")
        return EventStream(response, sockets, FAILURES, explain)

    # ------------------------------------------------------------ acting

    def start(self, ref: str) -> bool:
        """Start a container; a running one is left unchanged. Returns whether this call has started it."""

        def ask(client: APIClient) -> bool:
            url = f"{client.base_url}/v{client.api_version}/containers/{quote(ref, safe='')}/start"
            response = client.post(url, timeout=client.timeout)
            raise_for_status(response)
            return bool(response.status_code != NOT_MODIFIED)

        return bool(self._act(ask, f"start {ref}"))

    def restart(self, ref: str, stop_timeout_s: float = 5.0) -> None:
        """SIGTERM, SIGKILL after `stop_timeout_s` (rounded up to whole seconds), then start."""
        grace = _whole(stop_timeout_s)
        self._act(lambda client: client.restart(ref, timeout=grace), f"restart {ref}", grace)

    def stop(self, ref: str, stop_timeout_s: float = 5.0) -> None:
        grace = _whole(stop_timeout_s)
        self._act(lambda client: client.stop(ref, timeout=grace), f"stop {ref}", grace)

    def pause(self, ref: str) -> None:
        self._act(lambda client: client.pause(ref), f"pause {ref}")

    def unpause(self, ref: str) -> None:
        self._act(lambda client: client.unpause(ref), f"unpause {ref}")

    def kill(self, ref: str, signal: str = "SIGKILL") -> None:
        self._act(lambda client: client.kill(ref, signal=signal), f"kill {ref}")

    def set_cpu_shares(self, container: str, shares: int) -> None:
        """Set the CPU weight of a container while it runs; 1024 is the engine's default."""
        path, body = f"/containers/{quote(container, safe='')}/update", docker_bodies.cpu_shares(shares)
        self._act(lambda client: _post(client, path, body), f"set the CPU weight of {container}")

    def disconnect(self, network: str, container: str, force: bool = False) -> None:
        """Disconnect a container from a network; `force` also if the container is gone or half connected."""
        path, body = f"/networks/{quote(network, safe='')}/disconnect", docker_bodies.disconnect(container, force=force)
        self._act(lambda client: _post(client, path, body), f"disconnect {container} from {network}")

    def connect(self, network: str, container: str, aliases: Sequence[str] = (), addresses: Sequence[str] = ()) -> None:
        """Connect a container to a network, with `aliases` and fixed `addresses` (IPv4, IPv6 or both)."""
        path = f"/networks/{quote(network, safe='')}/connect"
        body = docker_bodies.connect(container, aliases, addresses)
        self._act(lambda client: _post(client, path, body), f"connect {container} to {network}")

    def exec_detached(self, container: str, argv: Sequence[str], user: str = "") -> None:
        """Start a program in a running container, with its environment and as its user unless another is given.

        No shell is involved. Returns when the program has been started; its outcome is unknown here.
        """

        def ask(client: APIClient) -> None:
            made = _post(client, f"/containers/{quote(container, safe='')}/exec", docker_bodies.exec_(argv, user))
            _post(client, f"/exec/{quote(made.json()['Id'], safe='')}/start", docker_bodies.START_EXEC)

        self._act(ask, f"run {argv[0] if argv else 'nothing'} in {container}")

    def exec_create(self, container: str, argv: Sequence[str]) -> str:
        """Prepare a program to run in a container, with its environment and as its user. Returns its id. No shell is involved."""
        path, body = f"/containers/{quote(container, safe='')}/exec", docker_bodies.exec_attached(argv)
        return self.call(lambda client: str(_post(client, path, body).json()["Id"]), what=f"prepare {argv[0]}")

    def exec_read(self, program: str, limit: int, *, deadline_s: float) -> tuple[bytes, bytes]:
        """Start the program and wait for its end. Returns the beginning of its output and errors, together at most `limit` bytes.

        EngineTimeout if it does not end in time; it goes on running, because the engine cannot end it.
        """

        def ask(client: APIClient) -> tuple[bytes, bytes]:
            path = f"/exec/{quote(program, safe='')}/start"
            response = _post(client, path, docker_bodies.START_ATTACHED, stream=True)
            try:
                data = docker_frames.beginning(response.raw, limit)
                while response.raw.read(65536):
                    pass  # until it ends
                return docker_frames.split(data)
            finally:
                response.close()

        return self.call(ask, deadline_s=deadline_s, what="run a program")

    def exec_exit_code(self, program: str) -> int | None:
        """The exit code of a program; None: it still runs; NEVER_STARTED: it was prepared and no more."""
        answer = self._ask(lambda client: client.exec_inspect(program), None, "look at a program")
        if answer.get("Running"):
            return None
        code = answer.get("ExitCode")
        return NEVER_STARTED if code is None else int(code)

    def logs(self, container: str, since: str, *, tail: int, limit: int, deadline_s: float | None = None) -> bytes:
        """The end of a container's log, with timestamps: at most `tail` lines, and of these the first `limit` bytes.

        since: see `docker_bodies.logs`. What programs wrote to both streams is in the order in which it came.
        """

        def ask(client: APIClient) -> bytes:
            url = f"{client.base_url}/v{client.api_version}/containers/{quote(container, safe='')}/logs"
            params = docker_bodies.logs(since, tail)
            response = client.get(url, params=params, stream=True, timeout=client.timeout)
            try:
                raise_for_status(response)
                return docker_frames.merged(docker_frames.beginning(response.raw, limit))
            finally:
                response.close()

        return self.call(ask, deadline_s=deadline_s, what=f"read the log of {container}")

    def create_from_image(self, image: str, labels: Mapping[str, str], name: str = "") -> str:
        """Create a container without network that is never started, to read files of an image. Returns its id."""

        def ask(client: APIClient) -> str:
            alone = client.create_host_config(network_mode="none")
            made = client.create_container(
                image, command=["never-started"], name=name or None, labels=dict(labels), host_config=alone
            )
            return str(made["Id"])

        return self.call(ask, deadline_s=self.act_limit_s, what=f"make a container of {image}")

    def remove(self, ref: str) -> None:
        """Remove a stopped container, with its anonymous volumes."""
        self._act(lambda client: client.remove_container(ref, v=True), f"remove {ref}")


def _whole(seconds: float) -> int:
    return max(0, -int(-seconds // 1))


def _post(client: APIClient, path: str, body: str, *, stream: bool = False) -> Response:
    response = client.post(
        f"{client.base_url}/v{client.api_version}{path}",
        data=body,
        headers={"Content-Type": "application/json"},
        timeout=client.timeout,
        stream=stream,
    )
    raise_for_status(response)
    return response
