"""Which files are tonight's captures, and when their bytes are read again."""

from __future__ import annotations

import datetime
import errno
import json
import os
import re
import time
import zoneinfo
from pathlib import Path

import pytest

from wbflow.cache.memo import Digests, EarlierCaptures
from wbflow.errors import UsageError
from wbflow.site.bursts import burst_ends
from wbflow.site.capture_files import changes_of
from wbflow.site.captures import backlog, find_captures, night, nothing_matches
from wbflow.site.hanging_disks import Reader
from wbflow.site.load import load_site
from wbflow.site.models import Site
from wbflow.site.stale_cameras import find_stale
from wbflow.site.yaml_document import SiteError


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


MIDNIGHT = ["{camera}/2026-11-10_235950.jpg", "{camera}/2026-11-11_000000.jpg", "{camera}/2026-11-11_000010.jpg"]
NEXT = ["{camera}/2026-11-11_235950.jpg", "{camera}/2026-11-12_000000.jpg", "{camera}/2026-11-12_000010.jpg"]


def of(cameras: list[str], patterns: list[str]) -> list[str]:
    return [name.replace("{camera}", camera) for camera in cameras for name in patterns]


def test_a_burst_across_midnight_is_one_night(tmp_path: Path) -> None:
    s = site(tmp_path, "{camera}/{date}_{time}.jpg", of(["gate", "roof"], [*MIDNIGHT, *NEXT]))
    assert backlog(s, datetime.date(2026, 1, 1)) == [datetime.date(2026, 11, 10), datetime.date(2026, 11, 11)]
    assert names(s)["gate"] == of(["gate"], NEXT)
    assert names(s, datetime.date(2026, 11, 10)) == {camera: of([camera], MIDNIGHT) for camera in ("gate", "roof")}
    assert names(s, datetime.date(2026, 11, 12)) == {"gate": [], "roof": []}


def test_a_camera_that_starts_seconds_later_after_midnight_is_of_the_same_burst(tmp_path: Path) -> None:
    late = of(["roof"], MIDNIGHT[1:])
    s = site(tmp_path, "{camera}/{date}_{time}.jpg", [*of(["gate"], MIDNIGHT), *late])
    assert night(s, None) == datetime.date(2026, 11, 10)
    assert names(s)["roof"] == late


def test_bursts_before_and_after_midnight_are_not_joined_with_others_of_their_days(tmp_path: Path) -> None:
    evening = ["{camera}/2026-11-10_210000.jpg", "{camera}/2026-11-10_210010.jpg"]
    s = site(tmp_path, "{camera}/{date}_{time}.jpg", of(["gate", "roof"], [*evening, "{camera}/2026-11-11_001500.jpg"]))
    assert names(s, datetime.date(2026, 11, 10))["gate"] == of(["gate"], evening)
    assert names(s, datetime.date(2026, 11, 11))["gate"] == ["gate/2026-11-11_001500.jpg"]


def test_a_record_of_the_whole_day_is_divided_by_midnight(tmp_path: Path) -> None:
    taken = [datetime.datetime(2026, 11, 10) + datetime.timedelta(minutes=5 * k) for k in range(3 * 288)]
    s = site(tmp_path, "{camera}/{date}_{time}.jpg", of(["gate", "roof"], [f"{{camera}}/{t:%Y-%m-%d_%H%M%S}.jpg" for t in taken]))
    assert [len(names(s, datetime.date(2026, 11, day))["gate"]) for day in (9, 10, 11, 12, 13)] == [0, 288, 288, 288, 0]


def test_clocks_that_are_changed_at_midnight_make_no_gap_in_a_burst() -> None:
    """In Cairo, 2026-04-24 begins at 1 o'clock."""
    before, after = datetime.datetime(2026, 4, 23, 23, 59, 50), datetime.datetime(2026, 4, 24, 1, 0, 0)
    assert burst_ends([before, after], zoneinfo.ZoneInfo("Africa/Cairo")) == {datetime.date(2026, 4, 24): after}
    assert burst_ends([before, after]) == {}


def test_captures_hours_apart_are_remarked_on(tmp_path: Path) -> None:
    apart = ["{camera}/2026-11-11_000005.jpg", "{camera}/2026-11-11_235955.jpg"]
    s = site(tmp_path, "{camera}/{date}_{time}.jpg", of(["gate"], apart) + of(["roof"], apart[1:]))
    date, digests = datetime.date(2026, 11, 11), Digests(None)
    fresh = find_stale(s, date, find_captures(s, date, digests), digests, EarlierCaptures(tmp_path / "memo.json"))
    assert fresh.notes == {
        "gate": "its captures of the night are 24 h apart, at 00:00 and 23:59 (2 in all); they are merged all the same"
    }


TWICE = "{camera}/{date:%Y/%m/%d}/{camera}_01_{date:%Y%m%d}{time:%H%M%S}.jpg"


@pytest.mark.parametrize(
    ("pattern", "right", "wrong"),
    [
        (TWICE, "gate/2026/11/19/gate_01_20261119033000.jpg", "gate/2026/11/19/gate_01_20261118033000.jpg"),
        ("{date}/{camera}_{date}.jpg", "2026-11-19/gate_2026-11-19.jpg", "2026-11-19/gate_2026-11-18.jpg"),
        ("{date:%Y}/{date:%j}/{camera}-{date:%y%m%d}.jpg", "2026/323/gate-261119.jpg", "2026/322/gate-261119.jpg"),
        ("{camera}/{date:%Y}/{date:%m}/{date:%d}/*.jpg", "gate/2026/11/19/1.jpg", "gate/2026/13/19/1.jpg"),
        ("{camera}_{date:%d-%m-%Y}_{time:%H-%M}.jpg", "gate_19-11-2026_03-30.jpg", "gate_19-11-26_03-30.jpg"),
        ("{camera}/{date:%d.%m.%Y}*.jpg", "gate/19.11.2026 a.jpg", "gate/32.11.2026 a.jpg"),
        ("{camera}/{date}?.jpg", "gate/2026-11-19a.jpg", "gate/2026-11-19ab.jpg"),
        ("{camera}/{date}_[ab].jpg", "gate/2026-11-19_b.jpg", "gate/2026-11-19_c.jpg"),
    ],
)
def test_dates_may_be_anywhere_in_a_name_and_twice_if_they_agree(tmp_path: Path, pattern: str, right: str, wrong: str) -> None:
    s = site(tmp_path, pattern, [right, wrong])
    assert night(s, None) == datetime.date(2026, 11, 19)
    assert names(s)["gate"] == [right]


def test_the_hour_of_12_is_read_with_its_half_of_the_day(tmp_path: Path) -> None:
    files = ["gate_20261119_113000AM.jpg", "gate_20261119_093000PM.jpg"]
    assert names(site(tmp_path, "{camera}_{date:%Y%m%d}_{time:%I%M%S%p}.jpg", files))["gate"] == files


ENGLISH = "; names of months and days are English there (November, Nov)"


@pytest.mark.parametrize(
    ("pattern", "file", "more"),
    [
        ("{camera}/{date:%Y%m%d}_{time:%H%M%S}.jpg", "gate/20261118_240000.jpg", ""),
        ("{camera}/{date:%m-%d-%Y}.jpg", "gate/19-11-2026.jpg", ""),
        ("{camera}/{date:%Y-%m-%d}.jpg", "gate/2026-1-9.jpg", ""),
        ("{camera}/{date:%d%b%Y}.jpg", "gate/19Nob2026.jpg", ENGLISH),
        ("{camera}/{date:%d-%B-%Y}.jpg", "gate/19-Dezember-2026.jpg", ENGLISH),
    ],
)
def test_a_name_whose_date_or_time_is_none_is_shown(tmp_path: Path, pattern: str, file: str, more: str) -> None:
    s = site(tmp_path, pattern, [file])
    assert nothing_matches(s, datetime.date(2026, 11, 19)) == (
        f"{file} has no valid date or time where captures.pattern ({pattern}) wants them{more}"
    )


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("{camera}/{date:%s}.jpg", "%s in {date:%s} is not known"),
        ("{camera}/{date:%F}.jpg", "%F in {date:%F} is not known"),
        ("{camera}/{date:%m-%d}.jpg", "does not say year, month and day"),
        ("{camera}/{date:%Y}.jpg", "does not say year, month and day"),
        ("{camera}/{date}_{time:%I%M%S}.jpg", "%I, the hour of 12, does not say which half of the day"),
        ("{camera}/{date}_{time:%T}.jpg", "%T in {time:%T} is not known"),
    ],
)
def test_a_date_that_cannot_be_read_is_refused(tmp_path: Path, pattern: str, message: str) -> None:
    with pytest.raises(SiteError, match=re.escape(message)):
        site(tmp_path, pattern, [])


@pytest.mark.parametrize("pattern", ["{camera}/*.jpg", "{camera}/**/*.JPG", "{camera}/{date}_*.Jpg"])
def test_the_case_of_a_suffix_does_not_matter(tmp_path: Path, pattern: str) -> None:
    files = ["gate/2026-11-19_1.jpg", "gate/2026-11-19_2.JPG", "gate/2026-11-19_3.Jpg"]
    s = site(tmp_path, pattern, [*files, "gate/2026-11-19_4.jpg.txt"])
    assert names(s)["gate"] == files


def test_the_case_of_a_suffix_does_not_matter_without_wildcards(tmp_path: Path) -> None:
    s = site(tmp_path, "{camera}.jpg", ["gate.JPG", "roof.jpg"])
    assert names(s) == {"gate": ["gate.JPG"], "roof": ["roof.jpg"]}
    assert s.captures.cameras() == {"gate", "roof"}


NOBODYS_FILES = [
    *(
        "@eaDir/1.jpg/SYNOPHOTO_THUMB_S.jpg",
        "#recycle/1.jpg",
        ".stversions/1~20261119.jpg",
        "@Recycle/1.jpg",
        "$RECYCLE.BIN/1.jpg",
    ),
    *(
        ".1.jpg",
        "._1.jpg",
        "Thumbs.db",
        "System Volume Information/1.jpg",
        "lost+found/1.jpg",
        ".thumbnails/1.jpg",
        "#Snapshot/1.jpg",
    ),
]


@pytest.mark.parametrize(
    ("pattern", "found"),
    [
        ("{camera}/**/*.jpg", ["gate/1.jpg", "gate/in/2.jpg"]),
        ("{camera}/*.jpg", ["gate/1.jpg"]),
        ("{camera}/**/*", ["gate/1.jpg", "gate/in/2.jpg"]),
        ("{camera}/*/*.jpg", ["gate/in/2.jpg"]),
    ],
)
def test_files_that_a_disk_keeps_for_itself_are_nobodys_captures(tmp_path: Path, pattern: str, found: list[str]) -> None:
    s = site(tmp_path, pattern, ["gate/1.jpg", "gate/in/2.jpg", *[f"gate/{name}" for name in NOBODYS_FILES]])
    assert names(s)["gate"] == found
    assert s.captures.cameras() == {"gate"}


def test_a_folder_that_a_pattern_names_is_searched_whatever_its_name(tmp_path: Path) -> None:
    assert names(site(tmp_path, "#recycle/{camera}.jpg", ["#recycle/gate.jpg"]))["gate"] == ["#recycle/gate.jpg"]


def test_a_pattern_that_matches_nothing_shows_what_it_wants_and_what_is_there(tmp_path: Path) -> None:
    s = site(tmp_path, "{camera}/{date:%Y-%m-%d}_*.jpg", [f"gate/IMG_000{k}.jpg" for k in range(5)])
    assert nothing_matches(s, datetime.date(2026, 11, 19)) == (
        "captures.pattern wants gate/2026-11-19_*.jpg, and there are gate/IMG_0000.jpg, gate/IMG_0001.jpg, gate/IMG_0002.jpg in "
        f"{tmp_path / 'in'}"
    )


def test_a_night_without_captures_is_told_the_three_nearest_nights_and_the_newest(tmp_path: Path) -> None:
    days = (2, 9, 11, 14, 28)
    s = site(tmp_path, "{camera}/{date:%Y-%m-%d}.jpg", [f"gate/2026-11-{day:02}.jpg" for day in days])
    assert nothing_matches(s, datetime.date(2026, 11, 12)) == (
        "there are 5 other nights with captures, the nearest 2026-11-09, 2026-11-11, 2026-11-14, the newest 2026-11-28"
    )
    assert nothing_matches(s, datetime.date(2026, 11, 27)).endswith("the nearest 2026-11-11, 2026-11-14, 2026-11-28")


def test_a_fault_of_our_own_is_raised_at_once_and_not_taken_for_a_disk_that_hangs() -> None:
    def read() -> None:
        raise re.error("of our own")

    start = time.monotonic()
    with pytest.raises(re.error, match="of our own"):
        Reader().read(read, 60.0)
    assert time.monotonic() - start < 10


def refused(folder: Path, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the system refuse to list a folder: root may read everything, so its rights cannot be taken away."""
    scandir = os.scandir

    def refusing(path: str) -> object:
        if Path(path) == folder:
            raise OSError(number, os.strerror(number), path)
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refusing)


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (errno.EACCES, "cannot be read: Permission denied; give the user who runs wbflow the right to read it"),
        (errno.EIO, "cannot be read: Input/output error; check its disk, or its mount and the network"),
        (errno.ESTALE, "cannot be read: Stale file handle; check its disk, or its mount and the network"),
        (errno.ETIMEDOUT, "cannot be read: Connection timed out; check its disk, or its mount and the network"),
    ],
)
@pytest.mark.parametrize("pattern", ["{camera}/*.jpg", "{camera}/**/*.jpg", "{camera}/{date}_{time}.jpg"])
def test_a_folder_that_cannot_be_read_costs_only_its_camera(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pattern: str, number: int, words: str
) -> None:
    s = site(tmp_path, pattern, ["gate/2026-11-19_120000.jpg", "roof/2026-11-19_120000.jpg"])
    date = datetime.date(2026, 11, 19)
    refused(tmp_path / "in/roof", number, monkeypatch)
    assert night(s, date if not s.captures.dated else None) == date
    found = find_captures(s, date, Digests(None))
    assert [bool(file.digest) for file in found["gate"]] == [True]
    (roof,) = found["roof"]
    assert (roof.name, roof.digest, roof.fault) == (f"folder {tmp_path}/in/roof", "", words)


@pytest.mark.parametrize("pattern", ["{camera}/*.jpg", "{camera}/{date}.jpg", "{camera}/{date:%Y/%m}/{date:%d}.jpg"])
def test_a_file_or_a_loop_of_links_in_place_of_a_folder_is_not_called_a_missing_capture(tmp_path: Path, pattern: str) -> None:
    s = site(tmp_path, pattern, ["roof"], "[gate, roof, shed]")
    (tmp_path / "in/gate").symlink_to("gate")
    found = find_captures(s, datetime.date(2026, 11, 19), Digests(None))
    assert found["shed"] == [], "a folder that is not there is no fault of its own"
    assert [file.name for file in found["gate"] + found["roof"]] == [f"folder {tmp_path}/in/gate", f"folder {tmp_path}/in/roof"]
    assert found["gate"][0].fault.endswith("its symbolic links lead in a circle: make them anew")
    assert found["roof"][0].fault == "cannot be read: Not a directory; move what lies there in place of the folder"


def test_a_folder_that_cannot_be_read_is_no_fault_where_the_captures_are_elsewhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    s = site(tmp_path, "**/{camera}.jpg", ["new/gate.jpg", "private/x.jpg"])
    refused(tmp_path / "in/private", errno.EACCES, monkeypatch)
    found = find_captures(s, datetime.date(2026, 11, 19), Digests(None))
    assert [file.name for file in found["gate"]] == ["new/gate.jpg"]
    assert [file.name for file in found["roof"]] == [f"folder {tmp_path}/in/private"]


def test_a_pattern_that_matches_nothing_names_a_root_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    s = site(tmp_path, "{camera}.jpg", ["gate.jpg"], "[bridge, tower]")
    refused(tmp_path / "in", errno.EACCES, monkeypatch)
    assert f"folder {tmp_path}/in cannot be read: Permission denied" in nothing_matches(s, datetime.date(2026, 11, 19))
