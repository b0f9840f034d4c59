"""Takes a configuration that an operator delivered: checks it, writes it, reloads, and returns to the previous one if that fails.

`phm.commands.delivery_server` has made sure that the sender has the key. Nothing is changed unless everything can be: see
docs/reference/security.md for what is refused, and why.
"""

from __future__ import annotations

import errno
import json
import logging
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace as changed
from pathlib import Path
from typing import TYPE_CHECKING, Any

from phm.config import ConfigError, Problem
from phm.config.atomic_write import replace
from phm.config.loader import DELIVERED, read_file
from phm.core.clock import Clock
from phm.core.settings import DeliverySettings
from phm.runtime.configuration import fixed_sections, read_text
from phm.runtime.daemon import Daemon
from phm.transport.mavlink_signing import InvalidKey, read_key
from phm.wire.delivery import DeliveryAnswer, version_of

if TYPE_CHECKING:
    from phm.commands.delivery_server import DeliveryServer

logger = logging.getLogger(__name__)

BACKUP = ".bak"
_VARIABLE = re.compile(r"\$\{([A-Za-z_][A-Za-z0-9_]*)")
LEAST_SECRET, COMPARED = 6, 8
"""Characters: shorter values of variables may be in an answer, and of others at most the beginning, which is compared."""


class _Refused(Exception):
    """Nothing was changed; the message says why."""

    def __init__(self, text: str, problems: tuple[Problem, ...] = ()) -> None:
        super().__init__(text)
        self.problems = problems


class Delivery:
    """file: the configuration of the running daemon. fixed: its `fixed_sections` when it started. daemon: the one that runs now.
    reload: reloads, as `phm reload`; the outcome as JSON. environ: for `${VAR}`. One call of `execute` at a time."""

    def __init__(
        self,
        file: str,
        fixed: Mapping[str, object],
        daemon: Callable[[], Daemon],
        reload: Callable[[], str],
        environ: Mapping[str, str] | None = None,
    ) -> None:
        self._file, self._fixed, self._daemon, self._reload = file, fixed, daemon, reload
        self._environ = os.environ if environ is None else environ

    def note(self, text: str) -> None:
        """Write a line into the log."""
        self._daemon().pipeline.note("PHM", text)

    def execute(self, text: str, base: str, who: str) -> DeliveryAnswer:
        """text: empty to ask for the present version alone. base: version of the file that it replaces. who: for the log. Never
        raises."""
        if not text:
            return DeliveryAnswer(True, "nothing was delivered", self._version())
        problems: tuple[Problem, ...] = ()
        try:
            done, words = self._take(text, base, who)
        except _Refused as refused:
            done, words, problems = False, str(refused), refused.problems
            self.note(f"a configuration from {who} was refused: {words}")
        except Exception as error:  # a defect must not leave the sender without an answer
            logger.exception("a delivered configuration could not be applied")
            done, words = False, f"PHM failed ({type(error).__name__}): see its log"
        return DeliveryAnswer(done, words, self._version(), tuple(_problem(each) for each in problems))

    def _take(self, text: str, base: str, who: str) -> tuple[bool, str]:
        path = Path(os.path.realpath(self._file))
        present = self._check_base(path, base, version_of(text))
        self._check_armed()
        self._check_content(text)
        before = path.read_bytes()
        if version_of(before.decode("utf-8-sig", "replace")) != present:
            raise _Refused("the agent's file was changed meanwhile: begin again")
        try:
            replace(path.with_name(path.name + BACKUP), before, like=path)
            self._check_armed()  # again, as late as possible: to validate and to write take a while
            replace(path, text.encode("utf-8"))
        except OSError as error:
            raise _Refused(_not_written(path, error)) from None
        self.note(f"configuration {version_of(text)[:12]} from {who} replaces {present[:12]} in {self._file}")
        return self._apply(path, before)

    def _apply(self, path: Path, before: bytes) -> tuple[bool, str]:
        """Reload. If that fails, the previous file is there again."""
        ok, why = self._reloaded()
        if ok:
            return True, why
        try:
            _put_back(path, before)
        except OSError as error:
            words = f"not applied: {why}. The previous file could not be written again ({error.strerror or error}): it is {path.name}{BACKUP}"
            self.note(words)
            return False, words
        back, again = self._reloaded()  # the one before may have been late instead of refused
        words = f"not applied, the previous configuration is back: {why}"
        if not back:
            words = (
                f"failed: {why}. The previous file is back, but PHM may run with the delivered one, because it could not reload again "
                f"({again}): run `phm reload` on the agent"
            )
        self.note(words)
        return False, words

    def _reloaded(self) -> tuple[bool, str]:
        """Whether it succeeded, and its outcome or the reason. Never raises: the previous file must return whatever happens."""
        try:
            outcome = json.loads(self._reload())
            if outcome["ok"]:
                return True, str(outcome["text"])
            return False, str(outcome["why"] or "; ".join(each["text"] for each in outcome["problems"][:3]))
        except Exception as error:
            logger.exception("the delivered configuration could not be reloaded")
            return False, f"PHM failed ({type(error).__name__})"

    # ------------------------------------------------------------ what is refused

    def _check_armed(self) -> None:
        status = self._daemon().components.armed.now()
        if status.restricts:
            raise _Refused(f"the configuration is changed only while the vehicle is known to be disarmed: {status.why}")

    def _check_base(self, path: Path, base: str, wanted: str) -> str:
        try:
            present = version_of(read_file(path))
        except ConfigError as error:
            raise _Refused(f"the present configuration cannot be read: {error}") from None
        if present == wanted:
            raise _Refused("the agent has this configuration already")
        if present != base:
            raise _Refused(
                f"the agent has another configuration ({present[:12]}) than the one that was changed ({base[:12]}): someone else "
                "changed it meanwhile"
            )
        return present

    def _check_content(self, text: str) -> None:
        try:
            wanted = read_text(text, self._file, self._environ).settings
        except ConfigError as error:
            count = len(error.problems)
            words = f"the configuration is invalid on the agent: {count} problem{'s' if count != 1 else ''}"
            raise _Refused(words, tuple(self._without_values(each, text) for each in error.problems)) from None
        # All but `delivery` apply after a restart, and a reload does not show whether PHM starts with them; without that one, nothing
        # could be delivered any more.
        fixed = [name for name, section in fixed_sections(wanted).items() if section != self._fixed[name]]
        if fixed:
            raise _Refused(
                f"{', '.join(fixed)}: cannot be changed by a delivery, because a reload does not apply it: change it on the agent, "
                "and restart PHM",
                tuple(Problem(self._file, 0, name, "cannot be changed by a delivery") for name in fixed),
            )

    def _without_values(self, problem: Problem, text: str) -> Problem:
        """An answer is not encrypted, so it has no value of the agent's variables."""
        values = (self._environ.get(name, "") for name in _VARIABLE.findall(text))
        starts = {value[:COMPARED] for value in values if len(value) >= LEAST_SECRET}
        if not any(start in problem.message or repr(start)[1:-1] in problem.message for start in starts):
            return problem
        return changed(
            problem,
            message="is wrong. The reason contains a value of the agent's environment, so it is not sent: run `phm validate` on the agent",
        )

    def _version(self) -> str:
        try:
            return version_of(read_file(Path(self._file)))
        except ConfigError:
            return ""


def open_server(
    delivery: Delivery, wanted: DeliverySettings, signing_key: str | None, agent: str, clock: Clock
) -> tuple[DeliveryServer | None, str]:
    """A server that is not started yet, or None; a sentence when it is wanted and cannot be used.

    signing_key: `mavlink.signing.key`, which must be another key. agent: its name.
    """
    if wanted.listen is None or wanted.key is None:
        return None, ""
    try:
        key = read_key(wanted.key, "delivery.key")
        if signing_key is not None and read_key(signing_key) == key:
            raise InvalidKey(
                "delivery.key: it is the key of mavlink.signing, which every ground station and autopilot has: make another one"
            )
    except InvalidKey as error:
        return None, f"{error}; `phm deliver` does not work"
    from phm.commands.delivery_server import DeliveryServer  # with an event loop, 1.3 MB: only where it is configured

    return DeliveryServer(wanted.address, key, agent, clock, delivery.execute, delivery.note), ""


def _put_back(path: Path, before: bytes) -> None:
    """The previous file again, on a full disk by its copy's name. Raises OSError."""
    try:
        replace(path, before)
    except OSError:
        os.replace(path.with_name(path.name + BACKUP), path)


def _problem(problem: Problem) -> dict[str, Any]:
    return {**asdict(problem), "text": str(problem)}


def _not_written(path: Path, error: OSError) -> str:
    why = error.strerror or str(error)
    if error.errno in (errno.EROFS, errno.EBUSY, errno.EXDEV):
        return (
            f"{path} cannot be replaced: {why}. To permit deliveries, start docker/compose.yaml with `-f docker/compose.deliver.yaml`; "
            f"in another Compose file, also that of `phm init` without `--deliver`, add `- FOLDER:{DELIVERED}` under volumes and "
            f"`PHM_CONFIG: {DELIVERED}/{path.name}` under environment; FOLDER is a folder on the host with {path.name} and without "
            f"the Compose file, and belongs to user {os.geteuid()}. Under systemd, add `ReadWritePaths={path.parent}` to "
            "phm.service. Or copy the file to the agent and run `phm reload`"
        )
    if error.errno in (errno.EACCES, errno.EPERM):
        return (
            f"{path} cannot be replaced: {why}. PHM's user (id {os.geteuid()}) must be able to write {path.parent}; or copy the file "
            "to the agent and run `phm reload`"
        )
    return f"{path} cannot be written: {why}"
