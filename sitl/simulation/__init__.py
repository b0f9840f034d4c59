"""Simulated autopilots, radios, routers and ground stations."""
