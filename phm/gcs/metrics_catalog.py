"""The metrics of the ground, by the conventions of Prometheus. `docs/reference/metrics.md` states them as a contract."""

from __future__ import annotations

from phm.wire.metrics_page import MetricCatalog

_GROUND = MetricCatalog()
ALL = _GROUND.metrics
_gauge, _counter = _GROUND.gauge, _GROUND.counter

INFO = _gauge("phm_gcs_info", "Always 1; the label has the version of phm gcs", "version")
PRESENT = _gauge(
    "phm_gcs_agent_present", "1 while an agent is received; 0 when it is lost, has left, or was never received", "agent"
)
AGE = _gauge(
    "phm_gcs_agent_age_seconds",
    "Seconds since the last heartbeat of an agent, or since the ground waits for the first; missing if left, or if the first may be on its way",
    "agent",
)
PERIOD = _gauge("phm_gcs_agent_period_seconds", "Usual seconds between two heartbeats of an agent", "agent")
AGENT_LEVEL = _gauge(
    "phm_gcs_agent_level", "Worst level of an agent that is received: 0 OK, 1 WARN, 2 ERROR, 3 STALE", "agent"
)
SLOT_LEVEL = _gauge(
    "phm_gcs_slot_level",
    "Level of a slot of an agent that is received: 0 OK, 1 WARN, 2 ERROR, 3 STALE",
    "agent",
    "slot",
)
GAPS = _counter(
    "phm_gcs_agent_gaps_total",
    "How often the heartbeats of an agent paused; presence: late or lost",
    "agent",
    "presence",
)
RESTARTS = _counter(
    "phm_gcs_agent_restarts_total", "Restarts and reloads of an agent's PHM that the ground saw", "agent"
)
AUTOPILOT_AGE = _gauge(
    "phm_gcs_autopilot_age_seconds", "Seconds since the last heartbeat of an agent's autopilot", "agent"
)
ARMED = _gauge(
    "phm_gcs_autopilot_armed", "1 if an agent's autopilot reports armed; missing while it is silent", "agent"
)
EVENTS = _counter("phm_gcs_events_total", "Events of the ground, by kind", "event")
TEXTS = _counter("phm_gcs_texts_total", "Lines of text that were received, without repetitions", "severity")
COMMANDS = _counter("phm_gcs_commands_sent_total", "Commands sent to agents, with their repetitions")
ANSWERS = _counter("phm_gcs_answers_total", "Answers of agents to commands, by result", "result")
LINK_OPEN = _gauge("phm_gcs_link_open", "1 while a link of the ground is open", "link")
RADIO_AGE = _gauge(
    "phm_gcs_radio_report_age_seconds", "Seconds since the last RADIO_STATUS of the ground's radio", "link"
)
RADIO_SIGNAL = _gauge(
    "phm_gcs_radio_signal", "Signal strength in the radio's own units, 0 to 254; side: local or remote", "link", "side"
)
RADIO_NOISE = _gauge(
    "phm_gcs_radio_noise", "Noise in the radio's own units, 0 to 254; side: local or remote", "link", "side"
)
RADIO_BUFFER = _gauge(
    "phm_gcs_radio_transmit_buffer_free_ratio", "Free share of the radio's transmit buffer, 0 to 1", "link"
)
REFUSED = _counter(
    "phm_gcs_refused_frames_total", "Frames that were not read: too many, or of more agents than the ground keeps"
)
PROBLEMS = _gauge("phm_gcs_problems", "Problems of the ground itself, as in the table of phm gcs")
