"""Changes go on from those of the night before, by its date, so that a thing keeps its id whatever is run when."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.toy_site import HELPERS, ToySite
from wbflow.cache.layout import WorkFolder

NIGHTS = {
    "2026-11-14": "",
    "2026-11-15": "stack -3",
    "2026-11-16": "stack -3, van 5, box 9",
    "2026-11-17": "van 5, box 9",
    "2026-11-18": "van 5, box 14, tent 2",
}


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ToySite:
    """A dated site with captures of five nights; the first one becomes the reference."""
    monkeypatch.syspath_prepend(str(HELPERS))
    toy = ToySite(tmp_path / "site", ["gate", "roof"], dated=True, compares=True, watched=True, backend="threading")
    for date, things in NIGHTS.items():
        toy.things(date, things)
    return toy


def run(site: ToySite, date: str, *options: str) -> dict[str, Any]:
    """The changes of a night, as they are recorded."""
    changes: dict[str, Any] = site.run("--date", date, *options)["changes"]
    return changes


def ids(changes: dict[str, Any]) -> dict[str, str]:
    return {change["zone"]: name for name, change in changes["changes"].items()}


def artifacts(site: ToySite) -> list[Path]:
    """The changes in the cache, in the order in which they were made."""
    return sorted((site.work / "cache" / "changes" / "site").glob("*.json"), key=lambda path: path.stat().st_mtime_ns)


def test_a_thing_keeps_its_id_from_its_first_night_to_its_last(site: ToySite) -> None:
    found = [run(site, date) for date in NIGHTS]
    assert [ids(changes) for changes in found if changes["compared"]] == [
        {"stack": "C1"},
        {"stack": "C1", "van": "C2", "box": "C3"},
        {"van": "C2", "box": "C3"},
        {"van": "C2", "box": "C3", "tent": "C4"},
    ]
    last = found[-1]["changes"]
    assert {name: (change["first"], change["last"]) for name, change in last.items()} == {
        "C2": ("2026-11-16", "2026-11-18"),
        "C3": ("2026-11-16", "2026-11-18"),
        "C4": ("2026-11-18", "2026-11-18"),
    }
    assert list(found[3]["gone"]) == ["C1"]
    assert found[3]["gone"]["C1"]["last"] == "2026-11-16"


def test_a_thing_that_is_not_seen_keeps_the_last_night_on_which_it_was(site: ToySite) -> None:
    site.things("2026-11-17", "van ?, box 9")
    for date in ("2026-11-14", "2026-11-15", "2026-11-16"):
        run(site, date)
    van = run(site, "2026-11-17")["changes"]["C2"]
    assert (van["seen"], van["first"], van["last"]) == (False, "2026-11-16", "2026-11-16")


def test_growth_is_noted_once_the_interval_lies_above_that_of_the_last_news(site: ToySite) -> None:
    site.things("2026-11-17", "box 10.5")  # 9.5 to 11.5 after 8 to 10: perhaps
    site.things("2026-11-18", "box 11.5")  # 10.5 to 12.5 is more than on the 16th, though not than on the 17th
    found = [run(site, date) for date in NIGHTS]
    grown = [next((c.get("grown") for c in changes["changes"].values() if c["zone"] == "box"), None) for changes in found[2:]]
    assert grown == [None, None, "2026-11-18"]


def test_the_rerun_of_an_old_night_goes_on_from_the_night_before_it(site: ToySite) -> None:
    found = {date: run(site, date) for date in NIGHTS}
    for date in ("2026-11-16", "2026-11-18"):
        again = site.run("--date", date)
        assert again["tasks"]["ran"] == 0
        log = (site.work / "runs" / again["run"] / "log.jsonl").read_text()
        assert "ids of other things" not in log
        assert again["changes"]["changes"] == found[date]["changes"]


def test_a_night_that_is_run_late_goes_on_from_the_night_before_it(site: ToySite) -> None:
    for date in ("2026-11-14", "2026-11-15", "2026-11-18"):
        run(site, date)
    assert ids(run(site, "2026-11-16")) == {"stack": "C1", "van": "C2", "box": "C3"}
    log = (site.work / "runs" / max(WorkFolder(site.work).run_ids()) / "log.jsonl").read_text()
    assert "C2, C3: on nights after this one, which ran before it, these are ids of other things" in log
    assert ids(run(site, "2026-11-17")) == {"van": "C2", "box": "C3"}
    assert ids(run(site, "2026-11-18")) == {"van": "C2", "box": "C3", "tent": "C4"}


def test_nights_since_a_day_are_worked_on_in_order(site: ToySite) -> None:
    site.run("--since", "2026-11-14")
    latest = json.loads((site.work / "runs" / "latest" / "run.json").read_text())
    assert ids(latest["changes"]) == {"van": "C2", "box": "C3", "tent": "C4"}


@pytest.mark.parametrize("way", ["removed", "damaged"])
def test_without_the_result_of_the_night_before_an_older_one_is_taken_and_no_id_is_given_twice(site: ToySite, way: str) -> None:
    for date in ("2026-11-14", "2026-11-15", "2026-11-16", "2026-11-17"):
        run(site, date)
    for receipt in artifacts(site)[-2:]:  # of the 16th and the 17th
        for file in receipt.parent.glob(f"{receipt.stem}.*"):
            if way == "removed":
                file.unlink()
            elif file != receipt:
                file.write_bytes(b"x" * file.stat().st_size)
    changes = run(site, "2026-11-18")
    assert ids(changes) == {"van": "C4", "box": "C5", "tent": "C6"}, "the 15th knows neither, and C2 and C3 were theirs"
    assert changes["gone"].keys() == {"C1"}
    log = (site.work / "runs" / "latest" / "log.jsonl").read_text()
    assert "the changes of the night of 2026-11-17 are no longer in the cache" in log


def test_ids_go_on_after_a_new_reference_is_pinned(site: ToySite) -> None:
    for date in ("2026-11-14", "2026-11-15", "2026-11-16"):
        run(site, date)
    site.wbflow("pin")
    assert ids(run(site, "2026-11-17")) == {"van": "C4", "box": "C5"}, "they are other changes: those since the 16th"


def test_a_cleanup_keeps_what_the_next_night_goes_on_from(site: ToySite) -> None:
    for date in ("2026-11-14", "2026-11-15", "2026-11-16", "2026-11-17"):
        run(site, date)
    run(site, "2026-11-16")  # the newest run is of an old night now
    assert site.wbflow("clean", "--keep", "1").returncode == 0
    assert ids(run(site, "2026-11-16")) == {"stack": "C1", "van": "C2", "box": "C3"}
    assert ids(run(site, "2026-11-18")) == {"van": "C2", "box": "C3", "tent": "C4"}


def test_a_cleanup_keeps_the_changes_of_a_night_after_which_none_were_found(site: ToySite) -> None:
    for date in ("2026-11-14", "2026-11-15", "2026-11-16"):
        run(site, date)
    site.run("--date", "2026-11-17", "--until", "poses")
    shutil.rmtree(site.work / "runs" / "latest-good", ignore_errors=True)
    assert site.wbflow("clean", "--keep", "1").returncode == 0
    assert ids(run(site, "2026-11-18")) == {"van": "C2", "box": "C3", "tent": "C4"}
