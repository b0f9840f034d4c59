"""From the configuration to results: which checks there are, when they run, and what becomes of their results."""
