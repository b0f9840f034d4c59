"""Calls to the Docker Engine about files in containers, as tar archives."""

from __future__ import annotations

import base64
import json
import posixpath
import tarfile
from collections.abc import Callable
from urllib.parse import quote

from docker import APIClient
from requests.models import Response

from phm.transport import docker_bodies
from phm.transport.docker_session import Answer, DockerSession, mapping, raise_for_status
from phm.transport.docker_tar import FileCopy, pack, unpack


class DockerFiles(DockerSession):
    """Errors as in `phm.transport.docker.DockerEngine`."""

    def stat_path(self, container: str, path: str, *, deadline_s: float | None = None) -> Answer:
        """`name`, `size`, `mode` (Go's FileMode), `mtime` and `linkTarget` of a path in a container.

        A symbolic link is not followed; `linkTarget` is its final target. EngineMissing if the path or the container
        does not exist.
        """

        def ask(client: APIClient) -> Answer:
            response = client.head(_archive_url(client, container), params={"path": path}, timeout=client.timeout)
            raise_for_status(response)
            return _stat(response)

        return self.call(ask, deadline_s=deadline_s, what=f"look at {path} in {container}")

    def read_file(self, container: str, path: str, limit: int = 1 << 20) -> bytes:
        """The content of a regular file of at most `limit` bytes."""
        content = bytearray()
        self.copy_file(container, path, content.extend, limit=limit)
        return bytes(content)

    def copy_file(
        self, container: str, path: str, sink: Callable[[bytes], object], *, limit: int, deadline_s: float | None = None
    ) -> int:
        """Pass the content of a regular file to `sink` in pieces. Returns its size in bytes.

        Raises CannotTell if the path is not a regular file (a link is not followed) or exceeds `limit`.
        """
        return self.copy_with_stat(container, path, sink, limit=limit, deadline_s=deadline_s)[0]

    def copy_with_stat(
        self, container: str, path: str, sink: Callable[[bytes], object], *, limit: int, deadline_s: float | None = None
    ) -> tuple[int, Answer]:
        """The same; also returns what `stat_path` says, at about the moment of the copy: compare the sizes."""
        member, stat = self._fetch(container, path, sink, limit, deadline_s)
        return member.size, stat

    def fetch_file(self, container: str, path: str, limit: int) -> FileCopy:
        """The file with its mode and owner; like `copy_file`, with the deadline of an action."""
        content = bytearray()
        member, _ = self._fetch(container, path, content.extend, limit, self.act_limit_s)
        return FileCopy(bytes(content), member.mode & 0o7777, member.uid, member.gid)

    def _fetch(
        self, container: str, path: str, sink: Callable[[bytes], object], limit: int, deadline_s: float | None
    ) -> tuple[tarfile.TarInfo, Answer]:
        def ask(client: APIClient) -> tuple[tarfile.TarInfo, Answer]:
            response = client.get(
                _archive_url(client, container), params={"path": path}, stream=True, timeout=client.timeout
            )
            try:
                raise_for_status(response)
                return unpack(response, sink, f"{path} in {container}", limit), _stat(response)
            finally:
                response.close()

        return self.call(ask, deadline_s=deadline_s, what=f"read {path} in {container}")

    def put_file(
        self, container: str, path: str, data: bytes, mode: int, uid: int = 0, gid: int = 0, *, base: str = ""
    ) -> None:
        """Write a regular file at `path`, replacing an existing one; a folder is never replaced.

        base: an existing folder above it (default: its own folder); folders below that are created.
        """
        folder = base or posixpath.dirname(path)
        made = pack(posixpath.relpath(path, folder), FileCopy(data, mode, uid, gid), self._clock.utc())

        def ask(client: APIClient) -> None:
            url, params = _archive_url(client, container), docker_bodies.upload(folder)
            raise_for_status(client.put(url, params=params, data=made, timeout=client.timeout))

        self._act(ask, f"put {path} into {container}")


def _stat(response: Response) -> Answer:
    """The engine's description of the path."""
    return mapping(json.loads(base64.b64decode(response.headers["X-Docker-Container-Path-Stat"])))


def _archive_url(client: APIClient, container: str) -> str:
    return f"{client.base_url}/v{client.api_version}/containers/{quote(container, safe='')}/archive"
