"""What was read once is shared without being read again, and whatever somebody has touched is read."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.helpers.toy_site import ToySite
from wbflow.store.artifact import file_digest
from wbflow.store.intact import Intact
from wbflow.store.layout import WorkFolder


@pytest.fixture
def toy(toy: ToySite) -> ToySite:
    """Tasks are done in threads: who did them does not matter here."""
    toy.backend = "threading"
    return toy


@pytest.fixture
def settled(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> ToySite:
    """A site with three nights behind it, each planned, whose cloud is known to be intact, however young its files are."""
    monkeypatch.setattr("wbflow.store.digests._SETTLED_NS", -(10**18))
    toy.keys = {"pin": "none"}  # a reference has copies, which are put back
    toy.write()
    for _ in range(3):
        toy.run()
        WorkFolder(toy.work).unchanged_memo.unlink()  # else the next night would not be planned
    assert Intact(WorkFolder(toy.work)).earlier("cloud.ply") is not None
    return toy


def artifact(toy: ToySite) -> Path:
    return next((toy.work / "cache" / "fuse").rglob("*.ply"))


def flip(file: Path) -> None:
    """Damage a file, to the byte as long as it was."""
    file.chmod(0o644)
    data = file.read_bytes()
    file.write_bytes(data[:-1] + bytes([data[-1] ^ 1]))


def rot(toy: ToySite) -> None:
    """What a disk does unseen: bytes of the artifact change, and nothing that tells of it."""
    work, file = WorkFolder(toy.work), artifact(toy)
    digest = file_digest(file)
    flip(file)
    known = Intact(work)
    known.read(file, digest)
    assert known.holds(file, digest)
    known.save()


def test_an_artifact_that_was_touched_is_read_and_made_again(settled: ToySite) -> None:
    cloud = settled.cloud
    flip(artifact(settled))
    settled.run()
    assert settled.cloud == cloud
    assert settled.ran() == {"fuse"}


def test_a_published_cloud_that_was_touched_is_not_published_again(settled: ToySite) -> None:
    cloud = settled.cloud
    flip(settled.work / "runs" / "latest-good" / "cloud.ply")
    record = settled.run()
    assert settled.cloud == cloud
    assert record["exit_code"] == 0


def test_where_no_published_cloud_is_left_the_artifact_is_read_whatever_is_remembered_of_it(settled: ToySite) -> None:
    cloud = settled.cloud
    rot(settled)
    shutil.rmtree(settled.work / "runs")
    settled.run()
    assert settled.cloud == cloud
    assert settled.ran() == {"fuse"}


def test_a_memo_that_is_damaged_or_of_another_version_costs_reading_only(settled: ToySite) -> None:
    memo = WorkFolder(settled.work).intact_memo
    memo.write_bytes(memo.read_bytes().replace(b"sha256", b"sha512"))
    cloud = settled.cloud
    assert settled.run()["tasks"]["ran"] == 0
    assert settled.cloud == cloud
