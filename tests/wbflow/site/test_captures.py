"""Which files are tonight's captures, and when their bytes are read again."""

from __future__ import annotations

import datetime
import json
import os
from pathlib import Path

import pytest

from wbflow.cache.memo import Digests
from wbflow.errors import UsageError
from wbflow.site.captures import backlog, changes_of, find_captures, night
from wbflow.site.load import load_site
from wbflow.site.models import Site


def site(folder: Path, pattern: str, files: list[str], cameras: str = "[gate, roof]") -> Site:
    for name in files:
        file = folder / "in" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(name)
    (folder / "in").mkdir(parents=True, exist_ok=True)
    (folder / "site.yaml").write_text(f"site: s\ncaptures: {{root: in, pattern: '{pattern}'}}\ncameras: {cameras}\n")
    return load_site(folder)


def names(s: Site, date: datetime.date | None = None) -> dict[str, list[str]]:
    found = find_captures(s, night(s, date), Digests(None))
    return {camera: [file.name for file in files] for camera, files in found.items()}


def test_a_pattern_finds_the_file_of_each_camera(tmp_path: Path) -> None:
    assert names(site(tmp_path, "{camera}.jpg", ["gate.jpg", "other.jpg"])) == {"gate": ["gate.jpg"], "roof": []}


@pytest.mark.parametrize(
    ("pattern", "old", "new"),
    [
        ("{camera}/{date:%Y-%m-%d}*.jpg", "gate/2026-11-18_1.jpg", "gate/2026-11-19_1.jpg"),
        ("{date:%Y/%m/%d}/{camera}.jpg", "2026/11/18/gate.jpg", "2026/11/19/gate.jpg"),
        ("{camera}-{date}.jpg", "gate-2026-11-18.jpg", "gate-2026-11-19.jpg"),
        ("**/{camera}_{date:%Y%m%d}T*.jpg", "a/b/gate_20261118T0300.jpg", "c/gate_20261119T0300.jpg"),
    ],
)
def test_the_newest_night_is_the_default_and_others_can_be_chosen(tmp_path: Path, pattern: str, old: str, new: str) -> None:
    s = site(tmp_path, pattern, [old, new])
    assert night(s, None) == datetime.date(2026, 11, 19)
    assert names(s)["gate"] == [new]
    assert names(s, datetime.date(2026, 11, 18))["gate"] == [old]


def test_photographs_without_a_date_in_their_names_are_dated_by_their_files(tmp_path: Path) -> None:
    s = site(tmp_path, "{camera}.jpg", ["gate.jpg", "roof.jpg"])
    assert night(s, None) == s.today()
    for name, day in (("gate", 11), ("roof", 12)):
        os.utime(tmp_path / "in" / f"{name}.jpg", (moment := datetime.datetime(2010, 10, day, 12).timestamp(), moment))
    assert night(s, None) == datetime.date(2010, 10, 12)
    assert night(s, datetime.date(2010, 10, 11)) == datetime.date(2010, 10, 11)


def test_frames_of_a_night_are_in_the_order_of_their_names(tmp_path: Path) -> None:
    files = [f"gate/2026-11-19_{i}.jpg" for i in (3, 1, 2)]
    assert names(site(tmp_path, "{camera}/{date}_*.jpg", files))["gate"] == sorted(files)


def test_shell_wildcards_in_the_path_of_a_site_are_literal(tmp_path: Path) -> None:
    folder = tmp_path / "odd [1] *"
    folder.mkdir()
    assert names(site(folder, "{camera}.jpg", ["gate.jpg"]))["gate"] == ["gate.jpg"]


def test_listed_images_are_captures_even_if_they_are_missing(tmp_path: Path) -> None:
    s = site(tmp_path, "x", ["a.jpg"], "[{id: gate, images: [a.jpg, none.jpg]}]")
    (found,) = find_captures(s, night(s, None), Digests(None)).values()
    assert [bool(file.digest) for file in found] == [True, False]


def test_digests_are_remembered_for_settled_files_only(tmp_path: Path) -> None:
    file = tmp_path / "a"
    file.write_text("one")
    digests = Digests(tmp_path / "memo.json")
    first = digests.of(file)
    stamp = file.stat()
    file.write_text("two")
    os.utime(file, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert digests.of(file) != first, "changed within the resolution of its time stamp"
    digests.save()
    assert not (tmp_path / "memo.json").exists(), "too young to be remembered"


def test_captures_are_ordered_by_the_valid_times_in_their_names(tmp_path: Path) -> None:
    files = [f"gate/2026-11-19/{i}_{t}.jpg" for i, t in ((1, "235501"), (2, "071500"), (3, "235459"), (4, "999999"))]
    s = site(tmp_path, "{camera}/{date:%Y-%m-%d}/*_{time:%H%M%S}.jpg", files)
    assert [Path(name).name for name in names(s)["gate"]] == ["4_999999.jpg", "2_071500.jpg", "3_235459.jpg", "1_235501.jpg"]


def test_future_dates_in_names_do_not_define_the_night_if_others_exist(tmp_path: Path) -> None:
    today = datetime.date.today()
    s = site(tmp_path, "{camera}_{date}.jpg", [f"gate_{today - datetime.timedelta(days=2)}.jpg", "roof_2199-01-01.jpg"])
    assert night(s, None) == today - datetime.timedelta(days=2)
    alone = site(tmp_path / "other", "{camera}_{date}.jpg", ["roof_2199-01-01.jpg"])
    assert night(alone, None) == datetime.date(2199, 1, 1)


def test_a_backlog_is_the_ordered_list_of_nights_with_captures(tmp_path: Path) -> None:
    s = site(tmp_path, "{camera}_{date}.jpg", ["gate_2026-11-12.jpg", "gate_2026-11-10.jpg", "roof_2026-11-11.jpg"])
    since = datetime.date(2026, 11, 11)
    assert backlog(s, since) == [since, datetime.date(2026, 11, 12)]
    with pytest.raises(UsageError, match="no captures since"):
        backlog(s, datetime.date(2026, 11, 13))
    with pytest.raises(UsageError, match=r"needs \{date\}"):
        backlog(site(tmp_path / "other", "{camera}.jpg", []), since)


def test_a_forgotten_digest_is_computed_again(tmp_path: Path) -> None:
    file = tmp_path / "a"
    file.write_text("one")
    digests = Digests(tmp_path / "memo.json")
    first = digests.of(file)
    digests.forget(file)
    file.write_text("two")
    assert digests.of(file) != first


def test_the_memo_of_digests_is_limited_in_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("wbflow.cache.memo._STABLE_NS", -(10**18))
    monkeypatch.setattr("wbflow.cache.memo._FORMER", 5)
    for day in range(20):
        file = tmp_path / f"{day}.jpg"
        file.write_text(str(day))
        digests = Digests(tmp_path / "memo.json")
        digests.of(file)
        digests.save()
    assert len(json.loads((tmp_path / "memo.json").read_bytes())["files"]) == 6


def test_growing_captures_are_in_motion_and_removed_ones_are_not(tmp_path: Path) -> None:
    s, digests = site(tmp_path, "{camera}.jpg", ["gate.jpg", "roof.jpg"]), Digests(None)
    found = find_captures(s, night(s, None), digests)
    assert changes_of(found, set(), digests) == {}
    with (tmp_path / "in" / "gate.jpg").open("a") as file:
        file.write("more of it")
    (tmp_path / "in" / "roof.jpg").unlink()
    assert changes_of(found, set(), digests) == {"gate": ["gate.jpg"]}
    assert changes_of(found, {tmp_path / "in" / "roof.jpg"}, digests)["roof"] == ["roof.jpg"], "it was replaced before"
