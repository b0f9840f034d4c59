"""A swarm of simulated agents on this machine: containers for each, radios between them. See docs/development/sitl.md."""
