"""Operator requests by MAVLink and by the control socket: authorized, executed and answered."""
