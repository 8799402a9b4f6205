"""Fixtures that many tests share."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.helpers.toy_site import HELPERS, ToySite


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ToySite:
    """A toy site of four cameras."""
    monkeypatch.syspath_prepend(str(HELPERS))
    return ToySite(tmp_path / "site", ["gate", "roof", "mast-1", "crane"])
