"""Dates and times follow the site's clocks, also when these are set forward or back."""

from __future__ import annotations

import datetime
import time
from pathlib import Path
from typing import Any, cast

import pytest

from tests.wbflow.verdict.test_rules import night as a_night
from wbflow.capture import take as capture
from wbflow.capture.take import Delivery
from wbflow.cli.common import date_at, day
from wbflow.report.data import ReportData
from wbflow.report.page import _when
from wbflow.site.captures import night
from wbflow.site.load import load_site
from wbflow.site.models import Site
from wbflow.site.yaml_document import SiteError


def site(folder: Path, timezone: str, pattern: str = "{camera}/{date}_{time}.jpg") -> Site:
    (folder / "site.yaml").write_text(
        f"site: yard\ntimezone: {timezone}\ncaptures: {{pattern: '{pattern}'}}\ncameras: [gate, roof]\n"
    )
    return load_site(folder)


def at(text: str) -> float:
    """Seconds since 1970 of a time given in UTC."""
    return datetime.datetime.fromisoformat(f"{text}+00:00").timestamp()


def clock(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    monkeypatch.setattr(time, "time", lambda: at(text))


@pytest.mark.parametrize(
    ("timezone", "moment", "today"),
    [
        ("Europe/Berlin", "2026-11-19T22:59:59", "2026-11-19"),
        ("Europe/Berlin", "2026-11-19T23:00:00", "2026-11-20"),
        ("Pacific/Auckland", "2026-11-19T11:00:00", "2026-11-20"),
        ("America/Los_Angeles", "2026-11-20T07:59:59", "2026-11-19"),
        # the day on which clocks are set forward has 23 hours, the day on which they are set back has 25
        ("Europe/Berlin", "2026-03-28T22:59:59", "2026-03-28"),
        ("Europe/Berlin", "2026-03-28T23:00:00", "2026-03-29"),
        ("Europe/Berlin", "2026-03-29T21:59:59", "2026-03-29"),
        ("Europe/Berlin", "2026-03-29T22:00:00", "2026-03-30"),
        ("Europe/Berlin", "2026-10-25T22:59:59", "2026-10-25"),
        ("Europe/Berlin", "2026-10-25T23:00:00", "2026-10-26"),
    ],
)
def test_a_day_ends_at_midnight_in_the_time_zone_of_the_site(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, timezone: str, moment: str, today: str
) -> None:
    there = site(tmp_path, timezone)
    clock(monkeypatch, moment)
    assert str(there.today()) == today
    assert night(there, None) == there.today(), "without captures, tonight's"
    yesterday = there.today() - datetime.timedelta(days=1)
    assert date_at(there, day("yesterday")) == date_at(there, day("-1")) == yesterday
    assert date_at(there, day("2026-01-02")) == datetime.date(2026, 1, 2)
    assert date_at(there, None) is None


@pytest.mark.parametrize(
    ("moment", "name"),
    [
        ("2026-11-19T13:30:00", "2026-11-19_143000"),
        ("2026-06-30T22:30:00", "2026-07-01_003000"),
        ("2026-03-29T00:59:59", "2026-03-29_015959"),
        ("2026-03-29T01:00:00", "2026-03-29_030000"),
        ("2026-10-25T00:30:00", "2026-10-25_023000"),
        ("2026-10-25T01:30:00", "2026-10-25_023000"),
        ("2026-10-25T02:00:00", "2026-10-25_030000"),
    ],
)
def test_captures_are_named_by_the_local_time_of_the_site(tmp_path: Path, moment: str, name: str) -> None:
    there = site(tmp_path, "Europe/Berlin")
    local = there.local(at(moment))
    assert there.captures.name("gate", local) == tmp_path / "gate" / f"{name}.jpg"
    assert there.captures.moment("gate", there.captures.name("gate", local)) == local.replace(tzinfo=None, fold=0)


def test_captures_of_a_repeated_hour_do_not_overwrite_each_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    there = site(tmp_path, "Europe/Berlin")
    for moment, content in (("2026-10-25T00:30:00", b"first"), ("2026-10-25T01:30:00", b"second")):
        clock(monkeypatch, moment)
        capture._write(there, Delivery("gate", 1), (content, at(moment)))
    files = there.captures.files("gate", datetime.date(2026, 10, 25))
    assert [file.read_bytes() for file in files] == [b"first", b"second"]
    assert [file.stat().st_mtime for file in files] == [at("2026-10-25T00:30:00"), at("2026-10-25T01:30:00")]


def test_a_pattern_without_times_of_day_overwrites_the_capture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    there = site(tmp_path, "Europe/Berlin", "{camera}/{date}.jpg")
    clock(monkeypatch, "2026-10-25T01:30:00")
    for content in (b"first", b"second"):
        capture._write(there, Delivery("gate", 1), (content, at("2026-10-25T01:30:00")))
    (file,) = there.captures.files("gate", datetime.date(2026, 10, 25))
    assert file.read_bytes() == b"second"


@pytest.mark.parametrize(
    ("date", "words"),
    [
        ("2026-11-20", "2026-11-20 04:15 CET to 04:16 CET"),
        ("2026-06-30", "2026-06-30 05:15 CEST to 05:16 CEST"),
    ],
)
def test_the_report_shows_the_local_time_of_the_site(tmp_path: Path, date: str, words: str) -> None:
    data = ReportData(cast(Any, None), a_night(date), (), {}, Path(), site(tmp_path, "Europe/Berlin"))
    assert _when(data) == words


@pytest.mark.parametrize(("name", "remedy"), [("Europe/Berln", "did you mean 'Europe/Berlin'"), ("Europe", ""), ("3", "such as")])
def test_an_unknown_time_zone_is_refused_with_its_line(tmp_path: Path, name: str, remedy: str) -> None:
    with pytest.raises(SiteError, match=rf"site.yaml:2:11: timezone: .*is not a time zone.*{remedy}"):
        site(tmp_path, name)
