"""Fixtures that many tests share."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.toy_site import HELPERS, ToySite
from wbflow.site import captures

SLOWEST = (
    "wbflow/test_yard.py",
    "wbflow/runner/test_run.py",
    "wbflow/commands/test_export.py",
    "wbflow/test_fountain.py",
    "wbflow/runner/test_dispatch.py",
    "wbflow/reference/test_reference.py",
    "wbflow/runner/test_plugins.py",
    "test_fault_campaign.py",
)
"""Test files that take about a minute or more; they start first, in this order.  The yard compiles all kernels while the second
file, which needs none, runs beside it; the others find them compiled."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Start the slowest files first; otherwise one process would still run them when the other has nothing left to do."""
    first = {Path(__file__).parent / name: place for place, name in enumerate(SLOWEST)}
    items.sort(key=lambda item: first.get(item.path, len(first)))


@pytest.fixture(autouse=True)
def no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    """Output is not folded to the width of a terminal, which pytest-xdist states to its workers."""
    monkeypatch.delenv("COLUMNS", raising=False)


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ToySite:
    """A toy site of four cameras."""
    monkeypatch.syspath_prepend(str(HELPERS))
    monkeypatch.setattr(captures, "QUIET_SECONDS", 0.0)  # captures are complete, though just written
    return ToySite(tmp_path / "site", ["gate", "roof", "mast-1", "crane"])
