"""Results of benches: the page has exactly the content of the stored tables."""

from __future__ import annotations

import results


def test_the_page_of_results_matches_the_stored_tables() -> None:
    assert results.PAGE.read_text() == results.markdown(results.read_tables())


def test_every_row_of_a_table_has_a_cell_for_each_column() -> None:
    tables = results.read_tables()
    assert tables
    for table in tables.values():
        assert all(len(row) == len(table.columns) for row in table.rows)
