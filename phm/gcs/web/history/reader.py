"""Queries of the history."""

from __future__ import annotations


class HistoryReader:
    """Reads what `phm.gcs.web.history.store` has written."""
