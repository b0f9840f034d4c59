"""Which actions are tried against which condition, and what is special about conditions and actions."""

from __future__ import annotations

from collections.abc import Mapping

LADDERS: Mapping[str, tuple[str, ...]] = {
    "exited": ("start", "restart"),
    "oom": ("start", "restart"),
    "created": ("start",),
    "paused": ("unpause", "restart"),
    "unhealthy": ("restart",),
    "disconnected": ("reconnect", "restart"),
    "address_silent": ("reconnect", "restart"),
    "sidecar_disconnected": ("join_network",),
    "node_missing": ("relaunch", "restart"),
    "node_hung": ("restart",),
    "quorum_dead": ("restart",),
    "publisher_not_received": ("restart",),
    "topic_silent": ("relaunch", "restart"),
    "rate_low": ("relaunch", "restart"),
    "publisher_lost": ("restart",),
    "subscriber_lost": ("restart",),
    "qos_mismatch": ("restart",),
    "node_duplicate": ("restart",),
    "not_ready": ("restart",),
    "transport_blocked": ("restart",),
    "data_frozen": ("restart",),
    "data_stamp": ("restart",),
    "data_gaps": ("restart",),
    "data_range": ("restart",),
    "file_missing": ("restore_file",),
    "file_not_executable": ("restore_file",),
    "file_altered": ("restore_file",),
    "device_replugged": ("restart",),
    "link_silent": ("reopen",),
    "radio_silent": ("reopen",),
    "autopilot_silent": ("reopen",),
    "disk_full": ("free_disk",),
    "cpu_starved": ("relieve",),
    "custom_failed": ("restart",),
}
"""Built-in ladders by condition. Conditions that are not listed are only reported: `restarting` because the engine's
own restart policy is at work, `dead` because the engine refuses to restart what it could not remove,
`not_started` because the container's creator has a minute to start it,
`not_received` because a restart does not open a transport that was never open."""
_DATA = frozenset({"data_frozen", "data_stamp", "data_gaps", "data_range"})
_TOPIC = frozenset({"topic_silent", "rate_low", "publisher_lost", "subscriber_lost", "qos_mismatch"}) | _DATA
PATIENT = _TOPIC | {"node_duplicate", "not_ready"}
"""Conditions that must have lasted `recovery.patience`: a source that pauses does not yet hang, and a node may
create its endpoints again by itself, be activated again, or be replaced by a copy that starts before it ends."""
LEARNED = _TOPIC
"""Of these, the ones whose pauses PHM knows after a while: see `patience_s`. A second node is started by someone, at any time."""
DOWN = frozenset({"exited", "oom", "created"})
"""Conditions of a container that does not run. A start makes nothing worse as long as its dependents are not restarted, so it
is tried for as long as the container is down: a part of the budget is reserved for it, and when that is used up, or recovery
has given up, it is tried once per `recovery.backoff_max`."""
GENTLE = frozenset({"relieve"})
"""Actions that disturb no container: limited by back-off only, they use up no budget."""
RESTORE = "restore_file"
START_NOTHING = frozenset({RESTORE, "relaunch", "unpause"})
"""Actions on a container that do not start it: the pause between two starts is not counted from them."""
APART = "sidecar_disconnected"
"""Condition of a network that PHM itself is not on."""
OUTSIDE = frozenset({"network_missing", APART})
"""Conditions that come from outside of every container: no action on a container causes them. While one of these lasts, a failed attempt
does not count (`phm.recovery.verification`)."""
AGAIN_WHILE_IT_LASTS = frozenset({"disconnected"})
"""Conditions that only the first step of the ladder can end: a restart does not connect a network. The next step follows only if
the unit has recovered and something that needs it has not."""
ADVISED = frozenset({"data_gaps", "data_range"})
"""Conditions for which the built-in ladder is only advised: the messages arrive and most of them are usable, and whether a restart
helps depends on the sensor or input behind the node. A user's own ladder is carried out."""
ONLY_IF_OK_BEFORE = frozenset(
    {
        "transport_blocked",
        "qos_mismatch",
        "node_duplicate",
        "quorum_dead",
        "publisher_not_received",
        "data_frozen",
        "data_stamp",
        "not_ready",
    }
)
"""Conditions that a restart ends only where the container's own start is not their cause: firewall rules of its network
namespace, a publisher that was created again, a second node started by an operator, a node that its neighbours no longer
receive, or one of them, a source that repeats old data, a wrong clock on another computer, a node that was deactivated. Where the
unit was OK in this generation, a restart restores what the start had, and is tried once; where it never was, nothing is done. A
user's own ladder is used unchanged."""
ONLY_IF_REACHED_BEFORE = frozenset({"address_silent"})
"""Conditions that may say nothing about the container: PHM may not reach its network, e.g. that of a rootless engine. Where the unit
was never OK in this generation, nor the address reached in this run of PHM, nothing is done. A user's own ladder is used unchanged."""
