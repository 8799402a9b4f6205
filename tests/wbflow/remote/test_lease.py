"""One writer for each object store, whoever else wants to write."""

from __future__ import annotations

import datetime
import json
from pathlib import Path

import pytest

from wbflow.cache.lock import Locked
from wbflow.remote import lease
from wbflow.remote.lease import NAME, Lease
from wbflow.remote.objects import Objects

pytest.importorskip("fsspec", reason="object stores need the extra: pip install 'wbflow[cloud]'")


@pytest.fixture
def store(tmp_path: Path) -> Objects:
    return Objects(f"file://{tmp_path}/store")


def held_since(minutes: float) -> bytes:
    """What somebody on another machine has said so long ago."""
    since = (datetime.datetime.now(datetime.UTC) - datetime.timedelta(minutes=minutes)).isoformat(timespec="seconds")
    return json.dumps(
        dict.fromkeys(("token", "machine", "process", "host"), "crane-pc") | {"since": since, "heard": since}
    ).encode()


def test_of_two_that_find_the_last_writer_gone_one_writes(store: Objects, monkeypatch: pytest.MonkeyPatch) -> None:
    store.write(NAME, held_since(minutes=11))

    def the_slower_one_comes(seconds: float) -> None:
        store.remove([NAME])  # it had looked before the quicker one was there
        store.write(NAME, held_since(minutes=0))

    monkeypatch.setattr("wbflow.remote.lease.time.sleep", the_slower_one_comes)
    with pytest.raises(Locked, match="crane-pc"):
        Lease(store).take(wait=False)


def test_who_waits_has_the_store_once_it_is_free(store: Objects, monkeypatch: pytest.MonkeyPatch) -> None:
    store.write(NAME, held_since(minutes=1))
    looked = []

    def leave(seconds: float) -> None:
        looked.append(seconds)
        if len(looked) == 2:
            store.remove([NAME])

    monkeypatch.setattr("wbflow.remote.lease.time.sleep", leave)
    mine = Lease(store)
    mine.take(wait=True)
    assert looked == [lease._LOOK_SECONDS] * 2 and mine.held()
    mine.leave()
    assert store.read(NAME) is None
