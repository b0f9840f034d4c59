"""SITL: simulated agents on one machine, faults to inject, and how PHM handles them. Not part of the daemon."""
