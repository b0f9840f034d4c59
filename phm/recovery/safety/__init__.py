"""Limits on what recovery may do: the armed state, flight-critical containers, one action per container at a time."""
