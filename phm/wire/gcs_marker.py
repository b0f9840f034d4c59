"""How agents recognise `phm gcs` by its HEARTBEAT."""

from __future__ import annotations

MONITOR = 0x50484D31
"""`custom_mode`, ASCII `PHM1`: this ground station shows status and is not the pilot's. Agents do not report its loss."""
