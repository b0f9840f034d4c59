"""Injects every fault on the real stack and reports what PHM did."""
