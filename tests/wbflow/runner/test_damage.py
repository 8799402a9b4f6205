"""Damage on disk is found, repaired and reported, and never leads to a wrong cloud."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.toy_site import ToySite
from wbflow.cache.layout import WorkFolder
from wbflow.commands.check import check_published


@pytest.fixture
def toy(toy: ToySite) -> ToySite:
    """A site without a reference, which would restore its own copies (see test_reference.py); tasks run in threads."""
    toy.keys["pin"] = "none"
    toy.backend = "threading"
    toy.write()
    return toy


def damage(path: Path, before: bytes, after: bytes) -> None:
    """Change some bytes of a file, as a failing disk or an editor would."""
    data = path.read_bytes()
    assert before in data, f"{path} has nothing to damage"
    path.write_bytes(data.replace(before, after, 1))


def repairs_of(toy: ToySite, code: int = 0) -> list[str]:
    """The repairs that a run reports, after checking that its log lists the same ones."""
    record: dict[str, Any] = toy.run(code=code)
    log = toy.work / "runs" / record["run"] / "log.jsonl"
    events = [json.loads(line) for line in log.read_text().splitlines()]
    assert [event["what"] for event in events if event.get("repaired")] == record["repaired"]
    return list(record["repaired"])


def receipts(toy: ToySite, stage: str) -> list[Path]:
    return sorted((toy.work / "cache" / stage).rglob("*.json"))


def check(toy: ToySite) -> list[str]:
    """The faults that `wbflow check` finds in published files."""
    return [finding.what for finding in check_published(WorkFolder(toy.work))]


def exchange(one: Path, other: Path) -> None:
    a, b = one.read_bytes(), other.read_bytes()
    one.write_bytes(b)
    other.write_bytes(a)


def test_no_repairs_are_reported_of_an_undamaged_work_folder(toy: ToySite) -> None:
    toy.run()
    assert repairs_of(toy) == []


def test_a_changed_receipt_is_found_and_its_task_runs_again(toy: ToySite) -> None:
    toy.run()
    cloud = toy.cloud
    (receipt,) = receipts(toy, "pairs")
    damage(receipt, b'"gate","roof"', b'"gate","gate"')
    assert any("pairs" in what and "is damaged" in what for what in repairs_of(toy))
    assert toy.cloud == cloud
    assert toy.ran() == {"pairs"}
    assert repairs_of(toy) == []


def test_exchanged_receipts_of_two_nights_are_found(toy: ToySite) -> None:
    toy.run()
    toy.capture("roof").write_text("another night")
    toy.run()
    cloud = toy.cloud
    subjects = {"frames/roof", "matches/gate--roof", "fuse/site"}
    for subject in subjects:
        exchange(*sorted((toy.work / "cache" / subject).glob("*.json")))
    reported = [what for what in repairs_of(toy) if "belongs to" in what]
    assert {subject for what in reported for subject in subjects if f"/{subject}/" in what} == subjects
    assert all(any(f"/{subject}/" in what for subject in subjects) for what in reported)  # and nothing else
    assert len(reported) == len(set(reported)) <= 2 * len(subjects)  # each exchanged receipt is reported once
    assert toy.cloud == cloud


def test_exchanged_artifacts_of_two_cameras_are_found(toy: ToySite) -> None:
    toy.run()
    cloud = toy.cloud
    one, other = (next(r.parent.glob("*.wbf")) for r in receipts(toy, "frames")[:2])
    exchange(one, other)
    toy.parameters = {"disparity": {"tolerance": 1.5}}  # so that tasks read the frames
    toy.write()
    toy.run()
    toy.parameters = {}
    toy.write()
    toy.run()
    assert toy.cloud == cloud
    assert any((toy.work / "quarantine").iterdir())


def test_receipts_of_an_earlier_version_are_neither_used_nor_called_damaged(toy: ToySite) -> None:
    toy.run()
    cloud = toy.cloud
    for path in receipts(toy, "rectify"):
        fields = json.loads(path.read_bytes())
        del fields["signed"], fields["of"]
        path.write_text(json.dumps(fields))
    assert repairs_of(toy) == []
    assert {task.split()[0] for task in toy.ran()} == {"rectify"}
    assert toy.cloud == cloud


def test_exchanged_digests_in_the_memo_of_captures_are_found(toy: ToySite, settled: None) -> None:
    toy.run()
    cloud = toy.cloud
    memo = toy.work / "cache" / "captures.json"
    text = memo.read_text()
    one, other, *_ = re.findall(r'"([0-9a-f]{32})"\]', text)
    memo.write_text(text.replace(one, "x").replace(other, one).replace("x", other, 1))
    assert [what for what in repairs_of(toy) if "captures.json is damaged" in what]
    assert toy.cloud == cloud
    assert toy.ran() == set()
    assert repairs_of(toy) == []


def test_a_changed_default_in_the_memo_of_functions_is_found(toy: ToySite) -> None:
    toy.run()
    cloud = toy.cloud
    memo = toy.work / "cache" / "functions.json"
    text = memo.read_text()
    assert '"shift"' in text
    memo.write_text(re.sub(r'("shift".{0,200}?)1\.0', r"\g<1>9.0", text, count=1))
    assert memo.read_text() != text
    assert [what for what in repairs_of(toy) if "functions.json is damaged" in what]
    assert toy.cloud == cloud
    assert toy.ran() == set()
    assert repairs_of(toy) == []


def test_a_damaged_artifact_that_several_tasks_read_is_reported_once(toy: ToySite) -> None:
    toy.run()
    cloud = toy.cloud
    victim = next((toy.work / "cache" / "features" / "gate").glob("*.wbf"))
    damage(victim, victim.read_bytes()[-2:-1], bytes([victim.read_bytes()[-2] ^ 1]))
    record = toy.run("--force", "matches")  # three pairs read it
    assert len([what for what in record["repaired"] if "features" in what]) == 1
    assert toy.cloud == cloud
    assert "features gate" in toy.ran()


def test_a_missing_artifact_is_made_again_and_reported(toy: ToySite) -> None:
    toy.file.write_text(json.dumps(json.loads(toy.file.read_text()) | {"pin": "none"}))
    toy.run()
    cloud = toy.cloud
    victim = next((toy.work / "cache" / "fuse").rglob("*.ply"))
    victim.unlink()
    assert any("is gone" in what for what in repairs_of(toy))
    assert toy.cloud == cloud


@pytest.fixture
def settled(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files count as settled from the moment that they are written, so that their digests are remembered at once."""
    monkeypatch.setattr("wbflow.cache.memo._STABLE_NS", -(10**18))


def test_check_finds_published_files_that_do_not_match_their_digests(toy: ToySite) -> None:
    record = toy.run()
    folder = toy.work / "runs" / record["run"]
    assert record["files"] == {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in (folder / "cameras.json", folder / "cloud.ply")
    }
    assert check(toy) == []
    (folder / "cloud.ply").chmod(0o644)
    damage(folder / "cloud.ply", b"end_header", b"End_header")
    (folder / "cameras.json").unlink()
    assert sorted(what.rpartition("/")[2] for what in check(toy)) == ["cameras.json is gone", "cloud.ply is damaged"]
    toy.run()
    assert not [what for what in check(toy) if record["run"] not in what]


def test_a_changed_digit_in_run_json_is_found(toy: ToySite) -> None:
    toy.run()
    record = (toy.work / "runs" / "latest").resolve() / "run.json"
    damage(record, b'"points": 12', b'"points": 92')
    assert ["is damaged" in what for what in check(toy)] == [True]
    toy.run()
    assert not re.search(r"\b92\b", toy.wbflow("history").stdout)


def test_folders_pipes_and_dangling_links_in_place_of_files_are_replaced(toy: ToySite) -> None:
    """Folders, pipes without a writer and dangling links in place of files: runs do not wait for them, and replace them."""
    toy.run()
    cloud, cache, latest = toy.cloud, toy.work / "cache", (toy.work / "runs" / "latest").resolve()

    def one(pattern: str) -> Path:
        return sorted(cache.glob(pattern))[0]

    def folder(path: Path) -> None:
        (path / "something").mkdir(parents=True)

    def link(path: Path) -> None:
        path.symlink_to("nothing")

    obstacles: list[tuple[Callable[[Path], None], Path]] = [
        (folder, one("disparity/*/*.json")),
        (folder, cache / "captures.json"),
        (folder, toy.work / "lock"),
        (folder, one("matches/*/*.wbf")),
        (os.mkfifo, one("geometry/*/*.wbf")),
        (os.mkfifo, toy.work / "ledger.sqlite"),
        (os.mkfifo, latest / "log.jsonl"),
        (os.mkfifo, one("fuse/*/*.view")),
        (os.mkfifo, one("frames/*/*.jpg")),
        (link, cache / "functions.json"),
        (link, one("depth/*/*.json")),
    ]
    for put, path in obstacles:
        path.unlink(missing_ok=True)
        put(path)
    toy.parameters = {"disparity": {"tolerance": 2.0}}
    toy.write()
    toy.run()
    toy.parameters = {}
    toy.write()
    toy.run()
    assert toy.cloud == cloud
    assert not toy.run()["repaired"]
