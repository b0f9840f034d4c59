"""A swarm for hours with rare faults: what grows meanwhile, and how many false alarms there are (docs/development/soak.md)."""
