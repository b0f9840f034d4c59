"""Joins the networks of the configured containers before ROS starts: DDS chooses its interfaces at that moment."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence

from phm.core.settings import ContainerSettings
from phm.facts import CannotTell, NoResponse
from phm.recovery.actions.join_network import join_networks, rejoin_networks
from phm.recovery.base import ActionContext

logger = logging.getLogger(__name__)


def join_all_networks(
    containers: Sequence[ContainerSettings],
    context: ActionContext,
    note: Callable[[str, str], None],
    *,
    ros_runs: bool,
) -> Sequence[ContainerSettings]:
    """In every recovery mode: it changes PHM's own container alone, and PHM needs it to observe. note: kind and text. ros_runs: restart
    ROS after a join. Never raises.

    Returns those from the first one on at which the engine did not answer: a hung one takes the full deadline for each.
    """
    for place, container in enumerate(containers):
        try:
            done = rejoin_networks(container, context) if ros_runs else join_networks(container, context)
        except CannotTell as error:
            note("PHM", f"could not join the networks of {container.key}: {error}")
            if isinstance(error, NoResponse):
                return containers[place:]
        except Exception as error:  # ROS must start whatever the engine answers
            logger.exception("could not join the networks of %s", container.key)
            note("PHM", f"could not join the networks of {container.key}: {type(error).__name__}: {error}")
        else:
            if done:
                note("ACTION", done)
    return ()
