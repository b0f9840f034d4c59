"""A fault campaign on a swarm, and its figures beside those of the PHM paper. See docs/development/campaign.md."""
