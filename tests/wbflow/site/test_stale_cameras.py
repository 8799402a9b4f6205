"""Cameras whose captures are not from tonight are reported."""

from __future__ import annotations

import datetime
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.helpers.toy_site import HELPERS, ToySite
from wbflow.cache.memo import Digests, EarlierCaptures
from wbflow.json_dataclass import read_json
from wbflow.site.captures import find_captures
from wbflow.site.load import load_site
from wbflow.site.models import Site
from wbflow.site.stale_cameras import FreshCaptures, find_stale, night_by_pictures, stale_by_image
from wbflow_stages.contracts.camera_figures import FrameFigures

NIGHT = datetime.date(2026, 11, 19)
DAY = datetime.timedelta(days=1)
PATTERN = "{camera}/{date}_{time}.jpg"


def deliver(folder: Path, night: datetime.date, **pictures: list[str]) -> None:
    """Write captures by camera; each is given as its time, and optionally its content: 143000=frame."""
    for camera, found in pictures.items():
        (folder / camera).mkdir(parents=True, exist_ok=True)
        for each in found:
            time, _, content = each.partition("=")
            (folder / camera / f"{night}_{time}.jpg").write_text(content or f"{camera} {night} {time}")


def a_site(folder: Path, pattern: str = PATTERN) -> Site:
    (folder / "in").mkdir(exist_ok=True)
    (folder / "site.yaml").write_text(f"site: s\ncaptures: {{root: in, pattern: '{pattern}'}}\ncameras: [gate, roof, mast]\n")
    return load_site(folder)


def checked_captures(site: Site, night: datetime.date, seen: EarlierCaptures) -> FreshCaptures:
    digests = Digests(None)
    return find_stale(site, night, find_captures(site, night, digests), digests, seen)


def test_a_picture_repeated_from_the_night_before_is_stale_without_a_memo(tmp_path: Path) -> None:
    site, folder = a_site(tmp_path), tmp_path / "in"
    deliver(folder, NIGHT - DAY, gate=["140000", "140100=last"], roof=["140000"], mast=["140000"])
    deliver(folder, NIGHT, gate=["140000=last", "140100=last"], roof=["140000"], mast=["140000"])
    found = checked_captures(site, NIGHT, EarlierCaptures(tmp_path / "memo"))
    assert found.stale.keys() == {"gate"}
    assert "2026-11-18" in found.stale["gate"].text
    assert len(found.captures["gate"]) == 1, "the same picture counts once"


def test_remembered_pictures_make_only_later_nights_stale(tmp_path: Path) -> None:
    site, folder, seen = a_site(tmp_path), tmp_path / "in", EarlierCaptures(tmp_path / "memo")
    everyone = {"roof": ["140000"], "mast": ["140000"]}
    deliver(folder, NIGHT - 2 * DAY, gate=["140000=frozen"], **everyone)
    checked_captures(site, NIGHT - 2 * DAY, seen)
    (folder / "gate" / f"{NIGHT - 2 * DAY}_140000.jpg").unlink()
    deliver(folder, NIGHT, gate=["140000=frozen"], **everyone)
    assert checked_captures(site, NIGHT, seen).stale.keys() == {"gate"}
    seen.save()
    assert checked_captures(site, NIGHT, EarlierCaptures(tmp_path / "memo")).stale.keys() == {"gate"}
    deliver(folder, NIGHT - 3 * DAY, gate=["140000=frozen"], **everyone)
    assert not checked_captures(site, NIGHT - 3 * DAY, seen).stale


def test_repeated_captures_count_once_and_are_stale_if_there_is_no_other(tmp_path: Path) -> None:
    site, folder = a_site(tmp_path), tmp_path / "in"
    deliver(folder, NIGHT, gate=["140000=a", "140100=a", "140200=b"], roof=["140000=r", "140100=r"], mast=["140000"])
    found = checked_captures(site, NIGHT, EarlierCaptures(tmp_path / "memo"))
    assert [file.path.name[-10:] for file in found.captures["gate"]] == ["140000.jpg", "140200.jpg"]
    assert "1 of 3" in found.notes["gate"]
    assert found.stale.keys() == {"roof"}
    assert "same picture" in found.stale["roof"].text


def test_repeated_empty_files_are_not_stale(tmp_path: Path) -> None:
    site, folder = a_site(tmp_path), tmp_path / "in"
    for date in (NIGHT - DAY, NIGHT):
        deliver(folder, date, gate=["140000", "140100"], roof=["140000"], mast=["140000"])
        for file in folder.rglob(f"gate/{date}_*"):
            file.write_bytes(b"")
    found = checked_captures(site, NIGHT, EarlierCaptures(tmp_path / "memo"))
    assert not found.stale
    assert len(found.captures["gate"]) == 2, "whoever reads them says that they are empty"


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_files_that_are_cut_within_their_headers_are_not_called_frozen(tmp_path: Path, suffix: str) -> None:
    site = a_site(tmp_path, PATTERN.replace("jpg", suffix))
    random = np.random.default_rng(0)
    for night in (NIGHT - DAY, NIGHT):
        for time in ("140000", "140100"):
            for camera, bytes_kept in (("gate", 40), ("roof", None), ("mast", None)):
                picture = cv2.imencode(f".{suffix}", random.integers(0, 255, (30, 40, 3), np.uint8))[1].tobytes()
                file = tmp_path / "in" / camera / f"{night}_{time}.{suffix}"
                file.parent.mkdir(exist_ok=True)
                file.write_bytes(picture[:bytes_kept])
    gate = [file.read_bytes() for file in (tmp_path / "in/gate").iterdir()]
    assert len(gate) == 4 and len(set(gate)) == 1, "their pictures differ, their headers do not"
    found = checked_captures(site, NIGHT, EarlierCaptures(tmp_path / "memo"))
    assert not found.stale and not found.notes
    assert len(found.captures["gate"]) == 2, "the frame task finds out that they are truncated"


def test_a_clock_that_is_hours_off_is_found_across_midnight(tmp_path: Path) -> None:
    site, folder = a_site(tmp_path), tmp_path / "in"
    deliver(folder, NIGHT, gate=["235800"], roof=["000300"], mast=["235900"])
    assert not checked_captures(site, NIGHT, EarlierCaptures(tmp_path / "memo")).stale
    deliver(folder, NIGHT + DAY, gate=["040000"], roof=["235000"], mast=["235900"])
    found = checked_captures(site, NIGHT + DAY, EarlierCaptures(tmp_path / "memo"))
    assert found.stale.keys() == {"gate"}
    assert found.stale["gate"].figures["hours_off"] == pytest.approx(4.1, abs=0.1)


def test_unchanged_undated_captures_are_stale_only_if_others_are_new(tmp_path: Path) -> None:
    site, folder, seen = a_site(tmp_path, "{camera}.jpg"), tmp_path / "in", EarlierCaptures(tmp_path / "memo")
    for camera in ("gate", "roof", "mast"):
        (folder / f"{camera}.jpg").write_text(camera)
    checked_captures(site, NIGHT, seen)
    assert not checked_captures(site, NIGHT + DAY, seen).stale, "photographs that are meant to stay"
    (folder / "gate.jpg").write_text("new")
    assert checked_captures(site, NIGHT + 2 * DAY, seen).stale.keys() == {"roof", "mast"}


@pytest.mark.parametrize(
    ("figures", "words"),
    [
        ({"unchanged": 0.999}, "frozen"),
        ({"unchanged": 0.6, "taken_first": "2026-11-12T14:00:00", "taken_last": "2026-11-12T14:05:00"}, "2026-11-12"),
        ({"taken_first": "2026-11-19T14:00:00", "taken_last": "2026-11-19T15:00:00", "taken_in_order": False}, "order"),
        ({"taken_first": "2026-11-19T22:00:00", "taken_last": "2026-11-20T04:00:00", "taken_in_order": True}, None),
        ({"unchanged": 0.3}, None),
        ({}, None),
    ],
)
def test_unchanged_or_wrongly_dated_pictures_are_stale(figures: dict[str, object], words: str | None) -> None:
    health = stale_by_image(read_json(FrameFigures, figures), "2026-11-19", in_order=True)
    assert (health is None) == (words is None)
    assert health is None or (health.state == "stale" and words is not None and words in health.text)


def photographed(*moments: str) -> list[FrameFigures]:
    return [FrameFigures(taken_first=moment, taken_last=moment) for moment in moments]


def test_undated_photographs_are_of_the_night_on_which_most_were_taken() -> None:
    week = photographed(*(f"2010-10-{day}T12:00:00" for day in range(10, 17)))
    one_day = photographed("2010-10-12T09:00:00", "2010-10-12T17:00:00", "2010-10-12T23:30:00", "2026-11-24T09:00:00")
    assert night_by_pictures(one_day) == "2010-10-12"
    assert [stale_by_image(figures, "2010-10-12", in_order=False) is None for figures in one_day] == [True, True, True, False]
    assert night_by_pictures(week) == "", "taken over a week: none of them is wrong"
    assert all(stale_by_image(figures, "", in_order=False) is None for figures in week)
    assert night_by_pictures([FrameFigures(), FrameFigures(taken_first="")]) == ""


def test_missed_nights_run_in_order_and_the_worst_decides_the_exit_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(HELPERS))
    toy = ToySite(tmp_path / "toy", ["a", "b", "c"])
    text = toy.file.read_text().replace('"{camera}.txt"', '"{camera}/{date}_{time}.txt"')
    toy.file.write_text(text)
    folder = toy.folder / "captures"
    for back, content in ((2, "one"), (1, "two"), (0, "three")):
        for camera in toy.cameras:
            (folder / camera).mkdir(exist_ok=True)
            (folder / camera / f"{NIGHT - back * DAY}_140000.txt").write_text(f"a view from {camera}: {content}")
    (folder / "b" / f"{NIGHT}_140000.txt").write_text("a view from b: two")
    records = toy.run("--since", str(NIGHT - DAY), code=3)
    assert isinstance(records, list)
    assert [(record["date"], record["exit_code"]) for record in records] == [(str(NIGHT - DAY), 0), (str(NIGHT), 3)]
    assert records[1]["verdict"]["findings"][0]["kind"] == "camera-stale"
    assert len({record["run"] for record in records}) == 2
    again = toy.run("--date", str(NIGHT), code=3)
    assert again["cameras"][1]["health"]["state"] == "stale", "a night that is run again is judged as it was"
