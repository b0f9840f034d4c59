"""The demonstration: one agent on Docker Compose, four faults."""
