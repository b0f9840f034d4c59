"""A fault campaign on a swarm, and its figures beside those of the PHM paper. See docs/campaign.md."""

from sitl.campaign.cli import main

__all__ = ["main"]
