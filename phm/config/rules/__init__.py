"""Rules between keys: names that must exist, names that must be unique, pairs in order. One module for each subject.

One function per rule; each reads the raw tree through `ConfigNode`, so it works although other parts are invalid.
"""

from __future__ import annotations

from collections.abc import Callable

from phm.config.node import ConfigNode
from phm.config.rules.containers import (
    absent_files_have_no_copy,
    container_parts_are_unique,
    containers_are_unique,
    containers_have_one_identity,
    containers_start_in_order,
    manifests_are_for_folders,
    named_containers_exist,
    recovery_keys_need_opt_in,
)
from phm.config.rules.custom import (
    custom_containers_exist,
    custom_keys_fit,
    custom_names_are_unique,
    custom_needs_are_units,
    custom_needs_have_no_loop,
    custom_patterns_compile,
)
from phm.config.rules.custom_values import (
    custom_fields_exist,
    custom_mavlink_has_a_link,
    custom_serial_ports_are_read_once,
    custom_services_have_one_type,
    own_topics_are_not_custom,
)
from phm.config.rules.fleet import fleet_certificates_are_used, fleet_has_endpoints, fleet_modes_match
from phm.config.rules.limits import disks_are_unique, limits_are_in_order
from phm.config.rules.mavlink import endpoints_are_unique, flight_critical_needs_autopilot, link_ids_are_unique
from phm.config.rules.names import names_of_checks, names_of_recovery, needs_have_no_loop
from phm.config.rules.readiness import (
    ready_keys_have_an_effect,
    ready_names_something,
    ready_topics_are_not_monitored,
    ready_within_verification,
)
from phm.config.rules.ros import (
    diagnostics_are_known,
    examined_fields_exist,
    examined_topics_have_a_rate,
    own_topics_are_not_measured,
    relaunch_has_a_container,
    ros_names_are_unique,
    topic_nodes_exist,
)

__all__ = ["check_all", "custom_needs_are_units", "names_of_checks", "names_of_recovery", "needs_have_no_loop"]


def check_all(root: ConfigNode) -> None:
    """Apply every rule that needs only the file."""
    for rule in RULES:
        rule(root)


RULES: tuple[Callable[[ConfigNode], None], ...] = (
    containers_have_one_identity,
    containers_are_unique,
    container_parts_are_unique,
    containers_start_in_order,
    absent_files_have_no_copy,
    manifests_are_for_folders,
    recovery_keys_need_opt_in,
    flight_critical_needs_autopilot,
    ros_names_are_unique,
    named_containers_exist,
    relaunch_has_a_container,
    topic_nodes_exist,
    diagnostics_are_known,
    own_topics_are_not_measured,
    examined_topics_have_a_rate,
    examined_fields_exist,
    ready_keys_have_an_effect,
    ready_names_something,
    ready_topics_are_not_monitored,
    ready_within_verification,
    endpoints_are_unique,
    link_ids_are_unique,
    limits_are_in_order,
    disks_are_unique,
    custom_names_are_unique,
    custom_containers_exist,
    custom_patterns_compile,
    custom_fields_exist,
    custom_mavlink_has_a_link,
    custom_serial_ports_are_read_once,
    custom_services_have_one_type,
    own_topics_are_not_custom,
    custom_keys_fit,
    custom_needs_have_no_loop,
    fleet_has_endpoints,
    fleet_modes_match,
    fleet_certificates_are_used,
)
