"""What the page remembers: samples, events and faults, in SQLite."""
