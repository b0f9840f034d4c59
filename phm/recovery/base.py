"""What a recovery action is: one step on one container, idempotent, with a deadline.

Found through the entry-point group ``phm.actions``; the entry point's name is the name used in ladders.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from phm.facts import Attachment, ContainerFact
from phm.model import Fault
from phm.settings import ContainerSettings, Settings
from phm.transport.docker import Engine


class ActionFailed(Exception):
    """The step could not be done; the message says why and what an operator can do."""


@dataclass(frozen=True)
class ActionContext:
    """What an action may use.

    container:  the engine's view of a configured container now, or None when there is none.
    myself:     PHM's own container, or None when it runs on the host.
    remembered: how a container was attached to a network when that was last seen.
    """

    engine: Engine
    settings: Settings
    container: Callable[[str], ContainerFact | None]
    myself: Callable[[], ContainerFact | None]
    remembered: Callable[[str, str], Attachment | None]


class Action(ABC):
    """One step. `on_myself` marks actions on PHM's own container, which need no opt-in."""

    name: ClassVar[str]
    deadline_s: ClassVar[float] = 20.0
    on_myself: ClassVar[bool] = False

    @abstractmethod
    def run(self, target: ContainerSettings, fault: Fault, context: ActionContext) -> str:
        """Do it; return a sentence for the log. Raises ActionFailed, NotPermitted or CannotTell.

        Called again after a failure or a restart of PHM: doing it twice must be harmless.
        """
