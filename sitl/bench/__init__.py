"""Benches: what PHM costs and how fast it is."""
