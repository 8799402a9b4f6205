"""Results of quick tasks are made to last together: no receipt is in its place before the bytes that it promises are on disk."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from wbflow.cache import store as under_test
from wbflow.cache.artifact import digest
from wbflow.cache.layout import WorkFolder
from wbflow.cache.store import Cache, Preimage, Receipt

DATA = b"bytes of a result"


@pytest.fixture
def cache(tmp_path: Path) -> Cache:
    (tmp_path / "cache").mkdir()
    return Cache(WorkFolder(tmp_path))


def receipt(camera: str) -> Receipt:
    preimage = Preimage("frames", (camera,), "module:function", "code", {}, {})
    key = preimage.key()
    return Receipt(f"frames {camera}", key, "ran", preimage, digest(DATA), file=f"{key}.wbf", bytes=len(DATA))


def there(cache: Cache, one: Receipt) -> bool:
    return Cache(cache.work).find(one.preimage, one.key) is not None


def test_receipts_come_when_all_bytes_last(cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
    both, when_synced = [receipt("gate"), receipt("roof")], []
    prepared = [cache.prepare(one, DATA) for one in both]
    monkeypatch.setattr(under_test, "sync_all", lambda folder: when_synced.append([there(cache, one) for one in both]))
    cache.settle(prepared)
    assert when_synced == [[False, False]], "one sync, and no receipt before it"
    assert all(there(cache, one) for one in both)
    assert cache.read(both[0].preimage.task, cache.path(both[0]), digest(DATA)) == DATA


def test_where_nothing_can_be_made_to_last_there_is_no_receipt(cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(folder: Path) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    prepared = [cache.prepare(receipt("gate"), DATA)]
    monkeypatch.setattr(under_test, "sync_all", broken)
    with pytest.raises(OSError, match="Input/output"):
        cache.settle(prepared)
    assert not there(cache, receipt("gate"))
    assert not list(cache.work.cache.rglob(".*")), "nothing half-written is left"


def test_a_receipt_whose_worker_was_lost_is_kept_by_the_run(cache: Cache) -> None:
    cache.prepare(receipt("gate"), DATA)  # and then the worker is gone
    cache.assure(receipt("gate"))
    assert there(cache, receipt("gate"))
    assert not list(cache.work.cache.rglob(".*"))
    stamp = cache.work.receipt(receipt("gate").preimage.task, receipt("gate").key).stat().st_mtime_ns
    cache.assure(receipt("gate"))
    assert cache.work.receipt(receipt("gate").preimage.task, receipt("gate").key).stat().st_mtime_ns == stamp
