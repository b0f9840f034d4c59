"""Holds: recovery leaves a container alone on request, during maintenance, or after a manual stop."""
