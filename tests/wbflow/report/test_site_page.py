"""The page about all nights of a site: calendar, changes, trends; what an operator finds in it, and what it costs."""

from __future__ import annotations

import datetime
import json
import re
import shutil
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from tests.helpers import made_up_run
from tests.helpers.browser import chromium, until
from tests.helpers.toy_site import HELPERS, ToySite
from wbflow.cli.main import main
from wbflow.pipeline.summaries import ChangesSummary, RecordedChange
from wbflow.records.changes import with_nights
from wbflow.records.findings import Finding, Verdict
from wbflow.records.killed_runs import mark_begun
from wbflow.records.ledger import Ledger
from wbflow.records.record import RunRecord
from wbflow.records.run_folder import UnfinishedRun
from wbflow.report.site_page import write_site_page
from wbflow.report.timeline import axis_of
from wbflow.site.models import Site
from wbflow_stages.contracts.ground_figures import CutFill

GOOD = Verdict("good")
DEGRADED = Verdict("degraded", (Finding("camera-lost", ("cam-2",), "nothing since yesterday", remedy="look at its power"),))
CONTAINER = RecordedChange(
    "new", x=11.3, y=15.0, z=1.3, length=6.0, width=2.4, height=2.6, volume=4.9, volume_least=4.2, volume_most=40.0
)
STACK = RecordedChange("vanished", x=2.0, y=3.0, length=2.5, width=2.0, height=1.5, volume=7.0, volume_least=6.0, volume_most=8.0)


def nights(*found: tuple[str, Mapping[str, RecordedChange]], verdict: Verdict = GOOD, reference: str = "") -> list[RunRecord]:
    """Nights, each with the changes since the reference that it found; they go on from each other as those of a site do."""
    records: list[RunRecord] = []
    for day, changes in found:
        gained = sum(change.volume for change in changes.values() if change.kind == "new")
        summary = ChangesSummary(
            files=tuple(f"change-{name}.jpg" for name in changes),
            compared=True,
            count=len(changes),
            cut_fill=CutFill(gained=gained, gained_least=0.8 * gained, gained_most=9.0 * gained),
            changes=changes,
        )
        results = {"changes": with_nights(summary, day, records[-1] if records else None)}
        run = f"{day.replace('-', '')}T031500Z"
        record = made_up_run.record(made_up_run.names(6), run, day, verdict=verdict, reference=reference, results=results)
        records.append(record)
    return records


def night(day: str, verdict: Verdict = GOOD) -> RunRecord:
    """A night without changes."""
    return nights((day, {}), verdict=verdict)[0]


def publish(site: Site, *nights: RunRecord) -> None:
    for record in nights:
        UnfinishedRun(site.work_folder, record.run).publish(record, [], "a report")


def index(site: Site, count: int, changes: Callable[[int], Mapping[str, RecordedChange]]) -> None:
    """Put so many nights up to 2026-11-18 into the ledger alone, as if their folders were cleaned up; every ninth is degraded.

    changes: those of a night by its number, from 0.
    """
    last = datetime.date(2026, 11, 18)
    days = [(last - datetime.timedelta(days=count - 1 - k)).isoformat() for k in range(count)]
    records = nights(*((day, changes(k)) for k, day in enumerate(days)))
    site.work_folder.root.mkdir(exist_ok=True)
    with Ledger(site.work_folder, writes=True) as ledger:
        for k, record in enumerate(records):
            ledger.record_run(replace(record, verdict=GOOD if k % 9 else DEGRADED))


class Page(HTMLParser):
    """What a reader finds in the page: the texts of elements by id, and the links of the calendar by date."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self.texts: dict[str, str] = {}
        self.links: dict[str, list[str]] = {}
        self.days: dict[str, tuple[str, str]] = {}
        """State and title of each night, by date."""
        self._open: list[str] = []
        self.feed(path.read_text())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attrs}
        if given.get("id", "").startswith(("night-", "change-", "trends")):
            self._open = [given["id"]]
        if tag == "a":
            self.links.setdefault(self._open[0] if self._open else "", []).append(given["href"])
            if "aria-label" in given:
                self.days[given["aria-label"][:10]] = (given["class"], given["title"])

    def handle_endtag(self, tag: str) -> None:
        if tag in {"article", "tr", "section"}:
            self._open = []

    def handle_data(self, data: str) -> None:
        if self._open:
            self.texts[self._open[0]] = " ".join(f"{self.texts.get(self._open[0], '')} {data}".split())

    def report_of(self, date: str) -> list[Path]:
        """The files of reports that a night's entry links to."""
        links = [link for link in self.links.get(f"night-{date}", []) if link.endswith("report.html")]
        return [(self.path.parent / link).resolve() for link in links]


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return made_up_run.site(tmp_path, made_up_run.names(6))


def page_of(site: Site) -> Page:
    with Ledger(site.work_folder, writes=True) as ledger:
        ledger.catch_up()
    return Page(write_site_page(site))


def test_the_calendar_has_each_night_with_its_verdict_findings_and_report(site: Site) -> None:
    publish(site, night("2026-11-14"), night("2026-11-15", DEGRADED), night("2026-11-17"))
    page = page_of(site)
    assert {date: state for date, (state, _) in page.days.items()} == {
        "2026-11-14": "good",
        "2026-11-15": "degraded",
        "2026-11-17": "good",
    }
    assert page.report_of("2026-11-15") == [site.work_folder.run("20261115T031500Z").report.resolve()]
    text = page.texts["night-2026-11-15"]
    assert "cam-2: nothing since yesterday" in text
    assert "look at its power" in text
    assert {"#night-2026-11-14", "#night-2026-11-17"} < set(page.links["night-2026-11-15"]), "previous, next, newest"


def test_a_change_has_its_first_and_last_night_size_place_and_volume(site: Site) -> None:
    publish(
        site,
        *nights(
            ("2026-11-14", {"C1": STACK}),
            ("2026-11-16", {"C1": STACK, "C2": CONTAINER}),
            ("2026-11-17", {"C2": replace(CONTAINER, acknowledged="acknowledged by ida: delivered")}),
        ),
    )
    page = page_of(site)
    container = page.texts["change-C2"]
    for words in ("C2: new", "6.0 × 2.4 × 2.6 m", "4.2 to 40.0 m³", "11.3, 15.0, 1.3", "since 2026-11-16", "by ida: delivered"):
        assert words in container
    assert "2026-11-14 2026-11-16 gone on 2026-11-17" in page.texts["change-C1"]
    assert page.days["2026-11-16"] == ("good changed", "2026-11-16: good; new C2")
    assert page.days["2026-11-17"][1] == "2026-11-17: good; gone C1"


def test_changes_since_an_earlier_reference_are_not_called_gone(site: Site) -> None:
    publish(site, *nights(("2026-11-14", {"C1": STACK})), night("2026-11-15"))
    page = page_of(site)
    assert "not compared any more on 2026-11-15" in page.texts["change-C1"]
    assert "gone" not in page.days["2026-11-15"][1]


def test_a_night_that_compared_nothing_ends_no_change(site: Site) -> None:
    blind = replace(night("2026-11-15", Verdict("failed")), results={}, cloud=None)
    before, after = nights(("2026-11-14", {"C1": STACK}), ("2026-11-16", {"C1": STACK}))
    publish(site, before, blind, after)
    page = page_of(site)
    assert "since 2026-11-14" in page.texts["change-C1"]
    assert "gone" not in " ".join(title for _, title in page.days.values())
    assert "no cloud" in page.texts["night-2026-11-15"]


def test_nights_that_were_cleaned_up_or_killed_stay_in_the_calendar(site: Site) -> None:
    publish(site, night("2026-11-14", DEGRADED), night("2026-11-15"), night("2026-11-16"))
    page_of(site)
    work = site.work_folder
    shutil.rmtree(work.run("20261114T031500Z").folder)
    work.run("20261115T031500Z").report.unlink()
    mark_begun(work, "20261117T031500Z", "2026-11-17", datetime.datetime(2026, 11, 17, 3, 15, tzinfo=datetime.UTC))
    page = page_of(site)
    assert [state for state, _ in page.days.values()] == ["degraded", "good", "good", "killed"]
    assert "cleaned up" in page.texts["night-2026-11-14"]
    assert "nothing since yesterday" in page.texts["night-2026-11-14"]
    assert "report has been removed" in page.texts["night-2026-11-15"]
    assert "killed or crashed before its first result" in page.texts["night-2026-11-17"]
    assert page.report_of("2026-11-14") == page.report_of("2026-11-15") == []
    assert page.report_of("2026-11-16")[0].is_file()


def test_lengths_of_a_site_without_scale_have_no_unit(site: Site) -> None:
    records = nights(("2026-11-14", {"C1": CONTAINER}), ("2026-11-15", {"C1": CONTAINER}))
    publish(site, *(replace(record, poses=replace(record.poses, metric=False)) for record in records))  # type: ignore[type-var]
    page = page_of(site)
    assert "6.0 × 2.4 × 2.6; 4.2 to 40.0; at" in page.texts["change-C1"]
    assert "m³" not in page.path.read_text()


@pytest.mark.parametrize(
    ("low", "high", "lines"),
    [
        (0.0, 10.0, [0, 2, 4, 6, 8, 10]),
        (0.0, 1_871_899.0, [0, 500_000, 1_000_000, 1_500_000, 2_000_000]),
        (-0.0277, 0.03, [-0.03, -0.02, -0.01, 0, 0.01, 0.02, 0.03]),
        (7.0, 7.0, [6, 8]),
    ],
)
def test_the_lines_of_an_axis_are_round_numbers_around_the_values(low: float, high: float, lines: list[float]) -> None:
    assert axis_of(low, high) == pytest.approx(lines)


@pytest.mark.parametrize("exponent", range(-6, 9))
def test_an_axis_covers_its_values_with_few_lines(exponent: int) -> None:
    for high in (1.0, 1.7, 3.3, 9.99):
        lines = axis_of(0.3 * 10.0**exponent, high * 10.0**exponent)
        assert lines[0] <= 0.3 * 10.0**exponent <= high * 10.0**exponent <= lines[-1] * (1 + 1e-12)
        assert 2 <= len(lines) <= 9


def test_counts_have_axes_of_whole_numbers() -> None:
    assert axis_of(0.0, 2.0, whole=True) == [0, 1, 2]


def test_trends_have_axis_unit_and_interval(site: Site) -> None:
    publish(site, *nights(("2026-11-14", {}), ("2026-11-15", {"C1": CONTAINER}), ("2026-11-16", {"C1": CONTAINER})))
    text = page_of(site).texts["trends"]
    assert "volume gained, m³ now 4.9 m³ 0 " in text.replace(" 0.0 ", " 0 ")
    assert "2026-11-15: 4.9 m³ (3.92 to 44.1)" in text


def test_a_page_over_300_nights_costs_less_than_a_second_and_reads_no_records(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    index(site, 300, lambda k: {f"C{number}": CONTAINER for number in range(k // 10, k // 10 + 10)})
    monkeypatch.setattr(RunRecord, "from_json", lambda data: pytest.fail("a whole record was read"))
    began = time.process_time()
    page = write_site_page(site)
    assert time.process_time() - began < 1.0
    assert page.read_text().count('class="card one"') == 300
    assert page.stat().st_size < 2_000_000


def test_each_run_makes_the_page_and_report_and_page_link_to_each_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(HELPERS))
    toy = ToySite(tmp_path / "toy", ["gate", "mast", "roof"], dated=True, backend="threading")
    for date in ("2026-11-01", "2026-11-02"):
        toy.night(date)
        toy.run("--date", date)
    page = Page(toy.work / "site.html")
    assert list(page.days) == ["2026-11-01", "2026-11-02"]
    for date in page.days:
        (report,) = page.report_of(date)
        link = re.search(r'href="([^"]*site\.html)#night-([^"]*)"', report.read_text())
        assert link and link[2] == date
        assert (report.parent / link[1]).resolve() == page.path.resolve()
        assert str(page.path) in report.read_text(), "a report that was mailed says where the page is"
    before = page.path.read_bytes()
    result = CliRunner().invoke(main, ["site-report", str(toy.file)])
    assert (result.exit_code, result.stdout.strip()) == (0, str(page.path))
    assert page.path.read_bytes() == before
    assert CliRunner().invoke(main, ["clean", str(toy.file), "--keep", "1", "--reports", "1"]).exit_code == 0
    assert (Page(page.path).report_of("2026-11-01"), len(Page(page.path).report_of("2026-11-02"))) == ([], 1)
    elsewhere = tmp_path / "www" / "toy.html"
    assert CliRunner().invoke(main, ["site-report", str(toy.file), "--out", str(elsewhere)]).exit_code == 0
    assert Page(elsewhere).report_of("2026-11-02")[0].is_file()


def test_a_site_without_runs_has_no_page(site: Site) -> None:
    result = CliRunner().invoke(main, ["site-report", str(site.file)])
    assert result.exit_code == 2
    assert "no runs yet" in result.output
    assert not (site.file.parent / ".wbflow").exists()


def test_a_page_that_cannot_be_made_fails_no_night(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(HELPERS))
    toy = ToySite(tmp_path / "toy", ["gate", "mast", "roof"], backend="threading")

    def fail(site: Site) -> None:
        raise RuntimeError("no paper left")

    monkeypatch.setattr("wbflow.report.site_page.write_site_page", fail)
    toy.run(code=0)
    log = (toy.work / "runs" / "latest" / "log.jsonl").read_text().splitlines()
    assert [event["what"] for event in map(json.loads, log) if "no paper left" in str(event)] == [
        "the page of the site could not be made: RuntimeError: no paper left"
    ]
    assert not (toy.work / "site.html").exists()


@pytest.fixture(scope="module")
def long_page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A site of 40 nights, with names that are markup."""
    site = made_up_run.site(tmp_path_factory.mktemp("long"), made_up_run.names(6))
    hostile = replace(CONTAINER, zone="</script><script>document.title='taken'</script>")
    site.work_folder.root.mkdir()
    index(site, 40, lambda k: {"C1": hostile, **{f"C{number}": STACK for number in range(k + 2, k + 5)}})
    return write_site_page(site)


@pytest.fixture(scope="module")
def browser(long_page: Path) -> Iterator[Any]:
    with chromium(1000, 800) as driver:
        driver.get(long_page.as_uri())
        yield driver


SELECTED = "return [...document.querySelectorAll('.one')].filter(e => e.offsetParent).map(e => e.id)"


def test_the_page_makes_no_requests_and_logs_no_errors(browser: Any, long_page: Path) -> None:
    messages = [json.loads(entry["message"])["message"] for entry in browser.get_log("performance")]
    asked = {m["params"]["request"]["url"] for m in messages if m["method"] == "Network.requestWillBeSent"}
    assert {url for url in asked if not url.startswith("data:")} == {long_page.as_uri()}
    assert browser.get_log("browser") == []
    assert browser.title == "bowl: all nights"


def test_one_night_is_shown_at_a_time_and_chosen_in_the_calendar_by_links_or_arrow_keys(browser: Any) -> None:
    assert browser.execute_script(SELECTED) == ["night-2026-11-18"], "the newest"
    for script, shown in (
        ("document.querySelector('.month a[title^=\"2026-11-10\"]').click()", "night-2026-11-10"),
        ("document.querySelector('#night-2026-11-10 .moves a').click()", "night-2026-11-09"),
        ("dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowRight'}))", "night-2026-11-10"),
        ("dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowLeft'}))", "night-2026-11-09"),
        ("location.hash = '#changes'", "night-2026-11-09"),
        ("document.querySelector('#night-2026-11-09 .moves :last-child').click()", "night-2026-11-18"),
    ):
        browser.execute_script(script)
        until(browser, f"{SELECTED}.join() === '{shown}'")
    chosen = "return [...document.querySelectorAll('.month a[aria-current]')].map(e => e.title.slice(0, 10))"
    assert browser.execute_script(chosen) == ["2026-11-18"]


def test_nothing_overflows_on_a_phone_and_no_text_is_small(browser: Any) -> None:
    metrics = {"width": 390, "height": 800, "deviceScaleFactor": 1, "mobile": True}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    until(browser, "return innerWidth === 390")
    assert browser.execute_script("return document.documentElement.scrollWidth") == 390
    sizes = """return [...document.querySelectorAll('svg text, td, th, p, a, small, span')].filter(e => e.getClientRects().length)
      .map(e => parseFloat(getComputedStyle(e).fontSize) * (e.closest('svg') ? e.closest('svg').getScreenCTM().a : 1))"""
    assert min(browser.execute_script(sizes)) >= 11
