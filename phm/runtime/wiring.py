"""Builds the daemon, its successor after a reload, and the port for configurations. Building opens nothing and starts no thread."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from phm.checking.plan import CheckPlan
from phm.commands.services import no_reload
from phm.core import threads
from phm.core.clock import Clock, SystemClock
from phm.core.settings import Settings
from phm.core.watchdog import DaemonWatchdog
from phm.runtime.components import Components, ProcessParts
from phm.runtime.configuration import Configuration, fixed_sections
from phm.runtime.daemon import Daemon
from phm.runtime.delivery import Delivery, open_server
from phm.runtime.shutdown_marker import ShutdownMarker

if TYPE_CHECKING:
    from phm.commands.delivery_server import DeliveryServer


def build_daemon(
    settings: Settings,
    clock: Clock | None = None,
    watchdog: DaemonWatchdog | None = None,
    *,
    plan: CheckPlan | None = None,
    problems: Sequence[Callable[[], str]] = (threads.problem,),
    reload: Callable[[], str] = no_reload,
) -> Daemon:
    """The first daemon of a process. plan: see `Components`; the others: see `ProcessParts`."""
    process = ProcessParts(clock or SystemClock(), watchdog, problems, reload)
    return Daemon(Components(settings, process, plan=plan), ShutdownMarker(settings.state_dir))


def build_successor(previous: Daemon, settings: Settings, plan: CheckPlan | None = None) -> Daemon:
    """A daemon for another configuration; it replaces `previous` in its `start`. plan: see `Components`.

    Raises DependencyCycle; then, as after any other error, `previous` goes on unchanged.
    """
    before = previous.components
    with previous.handover():
        components = Components(settings, before.process, plan=plan, previous=before)
    return Daemon(components, previous.marker, previous)


def build_delivery(
    configuration: Configuration, clock: Clock, daemon: Callable[[], Daemon], reload: Callable[[], str]
) -> tuple[DeliveryServer | None, str]:
    """The port for configurations, see `open_server`. daemon: the one that runs now. reload: see `ProcessParts`."""
    settings = configuration.settings
    delivery = Delivery(configuration.file, fixed_sections(settings), daemon, reload)
    return open_server(delivery, settings.delivery, settings.mavlink.signing.key, settings.agent.name, clock)
