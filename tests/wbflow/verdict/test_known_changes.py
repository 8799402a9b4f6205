"""A change is acknowledged by its id, which it keeps for life."""

from __future__ import annotations

import datetime
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from tests.helpers import made_up_run
from tests.wbflow.verdict.test_rules import night
from wbflow.api import load_site
from wbflow.cache.layout import WorkFolder
from wbflow.cli.main import main
from wbflow.pipeline.summaries import ChangesSummary, RecordedChange
from wbflow.records.acknowledgement import Acknowledgement
from wbflow.records.findings import Verdict
from wbflow.records.record import RunRecord
from wbflow.records.run_folder import UnfinishedRun
from wbflow.site.models import Expected, Site
from wbflow.verdict import acknowledge
from wbflow.verdict.acknowledge import with_known
from wbflow.verdict.facts import Facts
from wbflow.verdict.rules import judge

STACK = RecordedChange("vanished", 9.2, 15.3, 1.3, length=1.8, width=0.7, height=4.2, id="C1", first="2026-11-18")
CONTAINER = RecordedChange(
    "new", 9.24, 15.31, 1.3, length=6.3, width=2.7, height=2.6, volume_least=4.0, volume_most=39.2, id="C2", first="2026-11-19"
)
VAN = RecordedChange("new", 28.3, 16.3, 1.2, length=4.7, width=2.3, height=1.9, id="C17", first="2026-11-19")


def of_night(date: str, *changes: RecordedChange) -> RunRecord:
    things = {change.id: change for change in changes}
    results = {"changes": ChangesSummary(compared=True, count=len(things), changes=things)}
    return replace(night(date), reference="20261101T031500Z", results=results)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A site on whose newest night two changes stand, and another one is gone; today is the 20th of November."""
    monkeypatch.setattr(Site, "today", lambda site: datetime.date(2026, 11, 20))
    (tmp_path / "site.yaml").write_text("site: yard\ncaptures: {pattern: '{camera}'}\ncameras: [crane, gate, mast, roof]\n")
    for record in (of_night("2026-11-18", STACK), of_night("2026-11-19", VAN, CONTAINER)):
        UnfinishedRun(WorkFolder.default_for(tmp_path / "site.yaml", "yard"), record.run).publish(record, [], "")
    return tmp_path


def wbflow(folder: Path, *words: str) -> Result:
    return CliRunner().invoke(main, ["acknowledge", str(folder), *words])


def known_of(folder: Path, record: RunRecord) -> dict[str, str]:
    """The acknowledgements of a night's changes, by id; "" without one."""
    there = acknowledge.read(load_site(folder))
    return {name: change.acknowledged for name, change in with_known(record, there).changes.items()}


def test_acknowledging_says_what_was_acknowledged_with_size_and_place(folder: Path) -> None:
    assert "C2: new 6.3 x 2.7 x 2.6 m at 9.2, 15.3; 4.0 to 39.2 m³; since 2026-11-19" in wbflow(folder).output
    result = wbflow(folder, "C2", "--note", "for the winter", "--until", "2026-12-24")
    assert result.exit_code == 0, result.output
    assert result.output.startswith("C2 new 6.3 x 2.7 x 2.6 m at 9.2, 15.3: acknowledged by ")
    assert result.output.endswith("until 2026-12-24: for the winter; from the next run on\n")
    listed = wbflow(folder).output
    assert "C2: new 6.3 x 2.7 x 2.6 m at 9.2, 15.3; acknowledged by " in listed
    assert "since 2026-11-19" in listed, "the van still counts"


def test_an_acknowledgement_holds_for_that_change_alone_and_until_it_expires(folder: Path) -> None:
    wbflow(folder, "C2", "--until", "2026-12-24")
    another = replace(CONTAINER, id="C18")
    tonight = known_of(folder, of_night("2026-11-20", another, replace(CONTAINER, x=9.6, volume_most=31.0)))
    assert tonight["C18"] == "", "another thing at the same place"
    assert "until 2026-12-24" in tonight["C2"]
    assert not any(known_of(folder, of_night("2026-12-25", CONTAINER)).values()), "it has expired"


def test_an_acknowledgement_is_replaced_and_dropped_by_id(folder: Path) -> None:
    wbflow(folder, "c2")
    wbflow(folder, "C2", "--note", "still there")
    (known,) = acknowledge.read(load_site(folder))
    assert (known.finding, known.note) == ("C2", "still there")
    assert "C2 new 6.3 x 2.7 x 2.6 m at 9.2, 15.3 counts again" in wbflow(folder, "C2", "--drop").output
    assert acknowledge.read(load_site(folder)) == ()
    assert "'C2' is not acknowledged" in wbflow(folder, "C2", "--drop").output


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        (("C71",), "there is no change C71\n  did you mean 'C17'? the changes of the newest night: C17 new "),
        (
            ("C400",),
            "there is no change C400\n  the changes of the newest night: C17 new 4.7 x 2.3 x 1.9 m at 28.3, 16.3; C2",
        ),
        (("C1",), "C1 (vanished 1.8 x 0.7 x 4.2 m at 9.2, 15.3) is gone since the night of 2026-11-19"),
        (("change", "2"), "name the change by its id, such as C17"),
        (("C2", "--until", "2026-11-19"), "--until 2026-11-19 has passed: today is 2026-11-20"),
        (("camera-lost", "gaet"), "did you mean 'gate'?"),
        (("camera-lots", "gate"), "did you mean 'camera-lost'?"),
    ],
)
def test_what_cannot_be_acknowledged_is_refused_with_what_exists(folder: Path, words: tuple[str, ...], answer: str) -> None:
    result = wbflow(folder, *words)
    assert result.exit_code == 2
    assert answer in result.output
    assert acknowledge.read(load_site(folder)) == ()


def test_acknowledgements_are_available_as_json(folder: Path) -> None:
    entry = json.loads(wbflow(folder, "C2", "--note", "for the winter", "--json").stdout)
    assert (entry["finding"], entry["note"], entry["dropped"]) == ("C2", "for the winter", False)
    listed = json.loads(wbflow(folder, "--json").stdout)
    assert [change["id"] for change in listed["changes"]] == ["C17"]
    assert [known["what"] for known in listed["acknowledged"]] == ["new 6.3 x 2.7 x 2.6 m at 9.2, 15.3"]


def judged(record: RunRecord, **facts: Any) -> tuple[int, list[str]]:
    """The exit code of a night, and the texts of its findings."""
    found = judge(record, Facts(**facts))
    assert found.verdict
    return int(found.exit_code), [finding.text for finding in found.verdict.findings]


def test_a_change_degrades_a_night_only_where_the_site_file_expects_none() -> None:
    record = of_night("2026-11-19", replace(CONTAINER, zone="quay"), VAN)
    container, van = "C2 new 6.3 x 2.7 x 2.6 m at 9.2, 15.3 in quay", "C17 new 4.7 x 2.3 x 1.9 m at 28.3, 16.3"
    assert judged(record) == (0, [])
    assert judged(record, expected=Expected(changes="none")) == (3, [container, van])
    assert judged(record, still_zones=frozenset({"quay"})) == (3, [container])
    known = (Acknowledgement("C2", "Ben", "2026-11-19"),)
    assert judged(record, still_zones=frozenset({"quay"}), acknowledged=known) == (0, [])


def test_run_json_contains_the_acknowledgements_of_changes() -> None:
    record = with_known(of_night("2026-11-20", CONTAINER), [Acknowledgement("C2", "Ben", "2026-11-19")])
    again = RunRecord.from_json(record.to_json())
    assert again.changes["C2"].acknowledged == "acknowledged by Ben on 2026-11-19"


def test_the_page_lists_acknowledged_changes_last_and_counts_them_apart(tmp_path: Path) -> None:
    record = made_up_run.record(made_up_run.names(3), verdict=Verdict("good"), exit_code=0)
    changes = ChangesSummary(compared=True, count=2, changes={"C2": CONTAINER, "C17": VAN})
    known = [Acknowledgement("C2", "Ben", "2026-12-01", note="for the winter")]
    page = made_up_run.page(tmp_path, with_known(replace(record, results={"changes": changes}), known), nights=0).read_text()
    first, _, _ = page.partition('class="stage"')
    assert "2 changes since the reference (2 new); 1 acknowledged." in first
    assert first.index('data-mark="C17"') < first.index('class="finding change known"') < first.index('data-mark="C2"')
    assert "since 2026-11-19; acknowledged by Ben on 2026-12-01: for the winter" in first
    assert page.count('class="card thing known"') == 1
