"""Captures in an object store (how nights are made of them: `night/test_object_store.py`)."""

from __future__ import annotations

from pathlib import Path

import pytest

from wbflow.cache.untrusted import Unreadable, read_outside
from wbflow.remote.delivery import bring
from wbflow.remote.standin import StandIn, stand_in, write_stand_in

pytest.importorskip("fsspec", reason="object stores need the extra: pip install 'wbflow[cloud]'")


def test_a_capture_that_says_it_stands_for_another_is_not_believed(tmp_path: Path) -> None:
    store, root = tmp_path / "delivered", tmp_path / "here"
    write_stand_in(store / "gate.txt", StandIn(9000, "", "gate.txt"))
    bring(root, f"file://{store}")
    with pytest.raises(Unreadable, match="not what it was"):
        read_outside(root / "gate.txt")


def test_a_capture_that_was_replaced_since_it_was_listed_is_no_capture_of_that_size(tmp_path: Path) -> None:
    store, root = tmp_path / "delivered", tmp_path / "here"
    store.mkdir()
    (store / "gate.txt").write_bytes(b"a view" * 1000)
    bring(root, f"file://{store}")
    assert (root / "gate.txt").stat().st_size == 6000 and stand_in(root / "gate.txt")
    (store / "gate.txt").write_bytes(b"another" * 1000)
    with pytest.raises(Unreadable, match="not what it was"):
        read_outside(root / "gate.txt")
    bring(root, f"file://{store}")
    assert read_outside(root / "gate.txt") == b"another" * 1000
