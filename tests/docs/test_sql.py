"""SQL of the documents is run by DuckDB on a dataset that `phm report --parquet` makes."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.docs.blocks import Block, blocks


@pytest.mark.extras
@pytest.mark.parametrize("block", blocks("sql"), ids=str)
def test_the_query_has_the_answer_of_the_records(block: Block, tmp_path: Path) -> None:
    """Two faults in one flight of one agent; the query sees both."""
    import duckdb  # not on every Python: see the marker

    from phm.review import parquet, record, record_reader
    from tests.review.test_document import one_flight

    one_flight(tmp_path / "log").close()
    parquet.write(record.build(record_reader.read(record_reader.find([str(tmp_path / "log")]))), str(tmp_path / "set"))
    query, replaced = re.subn(r"'fleet/", f"'{tmp_path}/set/", block.text)
    assert replaced == 1
    assert duckdb.execute(query).fetchall() == [("agent_1", 2)]
