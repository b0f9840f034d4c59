"""What survives a restart of PHM: open faults, attempts, holds and actions under way."""
