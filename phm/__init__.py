"""PHM: a health daemon for swarms of uncrewed aircraft, run as a sidecar container on each agent."""

__version__ = "0.2.0"
