"""Ports of the air process, inside its own container. A simulated autopilot of ArduPilot has 5760 + 10 i beside them."""

GROUND = 5500
CONTROL = 5501
ROUTER = 5600
"""Agent K's router: this plus K."""
PEERS = 14600
"""Agent K's radio on the network between agents: this plus K."""
