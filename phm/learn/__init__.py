"""Learns a configuration from an agent that works: `phm learn`.

Three steps, each of which can be tested by itself: `watch` reads with PHM's own probes and changes nothing, `baseline` turns what
was observed into settings and says where it is unsure, `merge` writes them into a configuration and keeps its comments.
"""
