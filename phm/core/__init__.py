"""What all of PHM is built on: records, clock, threads, settings, the event bus."""
