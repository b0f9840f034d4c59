"""The daemon as a process: construction in one place, start, reload and shutdown."""
