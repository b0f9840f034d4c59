"""The peers of ROS_STATIC_PEERS that can be resolved.

rmw_fastrtps creates no participant while one of them cannot: the name of a container that does not run, or on a network that PHM
has not joined yet. The child then discovers without it, and again once it can be resolved.
"""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable, MutableMapping

from phm.probes.ros import fastdds_profile

VARIABLE = "ROS_STATIC_PEERS"
RETRY_S, WAIT_S = 2.0, 2.0


class StaticPeers:
    """Keeps the variable to what can be resolved. With the range LOCALHOST the profile has the addresses: nothing is changed.

    A thread resolves, because a resolver without a network takes seconds for each name; `wait_s`: the longest wait for it here.
    """

    def __init__(
        self,
        environ: MutableMapping[str, str] = os.environ,
        resolve: Callable[[str], str] = socket.gethostbyname,
        retry_s: float = RETRY_S,
        wait_s: float = WAIT_S,
    ) -> None:
        self._environ, self._resolve, self._retry_s = environ, resolve, retry_s
        value = "" if fastdds_profile.localhost(environ) else environ.get(VARIABLE, "")
        self._names = [name for name in value.split(";") if name]
        self._found: list[str] = []
        self._tried = threading.Event()
        if self._names:
            threading.Thread(target=self._resolve_all, name="phm-peers", daemon=True).start()
            self._tried.wait(wait_s)
        self._used = self._found
        self._set()

    @property
    def missing(self) -> tuple[str, ...]:
        """Names that have not been resolved yet."""
        return tuple(name for name in self._names if name not in self._found)

    def more(self) -> bool:
        """Whether more can be resolved than the variable has; the variable then has all of them."""
        found = self._found
        if set(found) <= set(self._used):
            return False
        self._used = found
        self._set()
        return True

    def _set(self) -> None:
        if self._names:
            self._environ[VARIABLE] = ";".join(self._used)

    def _resolve_all(self) -> None:
        while True:
            for name in self._names:
                if name not in self._found and self._is_resolved(name):
                    self._found = [one for one in self._names if one in self._found or one == name]
            self._tried.set()
            if self._found == self._names:
                return
            time.sleep(self._retry_s)

    def _is_resolved(self, name: str) -> bool:
        try:
            self._resolve(name)
        except (OSError, UnicodeError):  # the second one: it cannot be a host name
            return False
        return True
