"""The metrics of an agent, by the conventions of Prometheus. `docs/reference/metrics.md` states them as a contract."""

from __future__ import annotations

from phm.core.model import Outcome
from phm.wire.metrics_page import MetricCatalog

SECONDS = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0, 300.0)
"""Limits of the histograms."""
OUTCOMES = (Outcome.RESOLVED, Outcome.ESCALATED, Outcome.REATTRIBUTED)
_AGENT = MetricCatalog()
ALL = _AGENT.metrics
_gauge, _counter, _histogram = _AGENT.gauge, _AGENT.counter, _AGENT.histogram

INFO = _gauge("phm_info", "Always 1; the labels say which agent this is", "agent", "agent_id", "version")
ALIVE = _gauge("phm_alive", "1 while PHM's checks run; 0 when they have stalled")
UPTIME = _gauge("phm_uptime_seconds", "Seconds since PHM started")
REPORT_AGE = _gauge("phm_report_age_seconds", "Seconds since the last complete pass over all checks")
STATUS_WORD = _gauge("phm_status_word", "The status word of the MAVLink heartbeat")
UNIT_LEVEL = _gauge("phm_unit_level", "Level of a unit: 0 OK, 1 WARN, 2 ERROR, 3 STALE", "unit", "slot")
SLOT_LEVEL = _gauge(
    "phm_slot_level", "Worst level in a slot of the status array: 0 OK, 1 WARN, 2 ERROR, 3 STALE", "slot"
)
FAULTS_OPEN = _gauge("phm_faults_open", "Faults that are open now", "slot")
FAULTS_GIVEN_UP = _gauge("phm_faults_given_up", "Faults that recovery has given up on and that still exist", "slot")
HOLDS = _gauge("phm_holds", "Holds that are in force")

ALARMS = _counter("phm_alarms_total", "Alarms: faults that were reported", "slot")
FAULTS = _counter(
    "phm_faults_total", "Faults that were closed; outcome: resolved, escalated or reattributed", "slot", "outcome"
)
ACTIONS = _counter(
    "phm_actions_total", "Steps of recovery actions; outcome: the phase of the step", "slot", "action", "outcome"
)
RECOVERY = _histogram(
    "phm_recovery_duration_seconds",
    "Seconds from the report of a fault to its end, of resolved faults whose end was observed",
    "slot",
)
CONFIRMATION = _histogram(
    "phm_detection_duration_seconds",
    "Seconds from the start of the first run that found an error to the report of the fault",
    "slot",
)

HEARTBEAT_AGE = _gauge(
    "phm_heartbeat_age_seconds", "Seconds since the last heartbeat; source: ground or autopilot", "source", "link"
)
AUTOPILOT_ARMED = _gauge("phm_autopilot_armed", "1 if the autopilot reports armed; missing while it is silent")
LINK_OPEN = _gauge("phm_link_open", "1 while a MAVLink endpoint is open", "link")
LINK_AGE = _gauge("phm_link_receive_age_seconds", "Seconds since the last bytes arrived", "link")
LINK_SENT = _counter("phm_link_sent_bytes_total", "Bytes sent", "link")
LINK_RECEIVED = _counter("phm_link_received_bytes_total", "Bytes received", "link")
LINK_LOSS = _gauge(
    "phm_link_loss_ratio",
    "Share of the frames of one sender that did not arrive, 0 to 1",
    "link",
    "system",
    "component",
)
RADIO_AGE = _gauge("phm_radio_report_age_seconds", "Seconds since the last RADIO_STATUS", "link")
RADIO_SIGNAL = _gauge(
    "phm_radio_signal", "Signal strength in the radio's own units, 0 to 254; side: local or remote", "link", "side"
)
RADIO_NOISE = _gauge("phm_radio_noise", "Noise in the radio's own units, 0 to 254", "link", "side")
RADIO_BUFFER = _gauge(
    "phm_radio_transmit_buffer_free_ratio", "Free share of the radio's transmit buffer, 0 to 1", "link"
)

TOPIC_RATE = _gauge("phm_topic_rate_hertz", "Measured rate of a topic", "topic")
TOPIC_EXPECTED = _gauge("phm_topic_expected_rate_hertz", "Configured rate of a topic", "topic")
TOPIC_SILENT = _gauge(
    "phm_topic_silent_seconds", "Seconds since a publisher of the topic was last seen to publish", "topic"
)

CPU_RATIO = _gauge("phm_host_cpu_usage_ratio", "Use of all cores together, 0 to 1")
LOAD = _gauge("phm_host_load_per_core", "Load average of one minute, for each core")
MEMORY_RATIO = _gauge("phm_host_memory_usage_ratio", "Share of the memory in use, 0 to 1")
MEMORY_FREE = _gauge("phm_host_memory_available_bytes", "Memory available to programs")
MEMORY_STALLED = _gauge(
    "phm_host_memory_stalled_ratio", "Share of the time in which tasks waited for memory and none ran"
)
IO_STALLED = _gauge("phm_host_io_stalled_ratio", "Share of the time in which tasks waited for disks and none ran")
TEMPERATURE = _gauge("phm_host_temperature_celsius", "Highest temperature of the processor")
DISK_RATIO = _gauge("phm_host_disk_usage_ratio", "Used share of a disk, 0 to 1", "path")
DISK_FREE = _gauge("phm_host_disk_free_bytes", "Free space of a disk", "path")
DISK_SIZE = _gauge("phm_host_disk_size_bytes", "Size of a disk without the part reserved for root", "path")

CONTAINER_CPUS = _gauge("phm_container_cpus", "CPUs that a container used", "container")
CONTAINER_CPU_LIMIT = _gauge(
    "phm_container_cpu_limit_cpus", "CPU limit of a container; missing without one", "container"
)
CONTAINER_MEMORY = _gauge(
    "phm_container_memory_bytes", "Memory that a container uses, with the page cache", "container"
)
CONTAINER_MEMORY_LIMIT = _gauge(
    "phm_container_memory_limit_bytes", "Memory limit of a container; missing without one", "container"
)
CONTAINER_PIDS = _gauge("phm_container_pids", "Processes and threads of a container", "container")
CONTAINER_PIDS_LIMIT = _gauge(
    "phm_container_pids_limit", "Limit of processes and threads of a container; missing without one", "container"
)
CONTAINER_THROTTLED = _gauge(
    "phm_container_cpu_throttled_ratio",
    "Share of the scheduling periods in which a container reached its CPU limit, 0 to 1",
    "container",
)
CONTAINER_WAITING = _gauge(
    "phm_container_waiting_ratio",
    "Share of the time in which a container waited; resource: cpu, memory or io",
    "container",
    "resource",
)
CUSTOM = _gauge("phm_custom_value", "A number that a custom check measured", "unit", "name")

THREADS = _gauge("phm_threads", "Threads of the daemon")
CHILDREN = _gauge("phm_children_memory_bytes", "Resident memory of PHM's child processes, such as the one for ROS")
CHILDREN_CPU = _gauge("phm_children_cpu_seconds", "CPU time of the child processes that run now")
QUEUE = _gauge("phm_event_queue_length", "Events that wait for a part of PHM", "subscriber")
DROPPED = _counter("phm_events_dropped_total", "Events that a part of PHM lost because it was too slow", "subscriber")
LATE = _gauge("phm_late_ratio", "Share of the last minute in which PHM could not run")
OVERDUE = _gauge("phm_checks_overdue", "Checks that have not finished within their deadline")
PROBLEMS = _gauge("phm_problems", "Problems of PHM itself; `phm status` shows them")
ROS_RESTARTS = _counter("phm_ros_restarts_total", "Restarts of the child process for ROS")
