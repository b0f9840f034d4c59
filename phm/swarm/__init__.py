"""The other agents and the consensus about them. Pure: the caller brings frames and time."""
