"""SITL: simulated agents on one machine, faults to inject, and what PHM makes of them. Not part of the daemon."""
