"""Acknowledged changes are recognised on later nights by kind and place, whatever their number there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from tests.helpers import made_up_run
from tests.helpers.toy_site import ToySite
from tests.wbflow.verdict.test_rules import night
from wbflow.api import load_site
from wbflow.cache.layout import WorkFolder
from wbflow.cli.main import main
from wbflow.pipeline.summaries import ChangesSummary, RecordedChange
from wbflow.records.acknowledgement import Acknowledgement
from wbflow.records.findings import Verdict
from wbflow.records.record import RunRecord
from wbflow.records.run_folder import UnfinishedRun
from wbflow.runner import publish
from wbflow.verdict import acknowledge, rules
from wbflow.verdict.acknowledge import changes_of, with_known

CONTAINER = RecordedChange("new", 9.24, 15.31, 1.3, length=6.3, width=2.7, volume=39.2)
VAN = RecordedChange("new", 28.3, 16.3, 1.2, length=4.7, width=2.3, volume=17.4)
STACK = RecordedChange("vanished", 9.2, 15.3, 1.3, length=1.8, width=0.7, volume=3.8)

CONTAINERS_NAME = "change new at 9.2,15.3,1.3"


def of_night(date: str, *changes: RecordedChange) -> RunRecord:
    things = {str(k): change for k, change in enumerate(changes, 1)}
    results = {"changes": ChangesSummary(compared=True, count=len(things), changes=things)}
    return replace(night(date), reference="20261101T031500Z", results=results)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A site whose newest night has two changes."""
    (tmp_path / "site.yaml").write_text("site: yard\ncaptures: {pattern: '{camera}'}\ncameras: [crane, gate, mast, roof]\n")
    record = of_night("2026-11-19", VAN, CONTAINER)
    UnfinishedRun(WorkFolder.default_for(tmp_path / "site.yaml", "yard"), record.run).publish(record, [], "")
    return tmp_path


def wbflow(folder: Path, *words: str) -> Result:
    return CliRunner().invoke(main, ["acknowledge", str(folder), *words])


def known_of(folder: Path, record: RunRecord) -> dict[str, str]:
    """The acknowledgements of a night's changes, by number; "" without one."""
    there = acknowledge.read(load_site(folder))
    return {number: change.acknowledged for number, change in changes_of(with_known(record, there)).items()}


def test_an_acknowledged_change_is_recognised_under_any_number(folder: Path) -> None:
    assert "change 2: new at 9.2, 15.3, 1.3" in wbflow(folder).output
    result = wbflow(folder, "change", "2", "--note", "for the winter", "--until", "2026-12-24")
    assert result.exit_code == 0, result.output
    nudged = replace(CONTAINER, x=9.6, volume=38.0)
    tonight = known_of(folder, of_night("2026-11-20", nudged, VAN, STACK))
    assert "until 2026-12-24: for the winter" in tonight["1"]
    assert (tonight["2"], tonight["3"]) == ("", ""), "another place, and another kind"
    assert not any(known_of(folder, of_night("2026-12-25", CONTAINER)).values()), "it has expired"


def test_an_acknowledgement_is_dropped_by_number_or_by_name(folder: Path) -> None:
    for words in (("change", "2"), ("change new at 9.2,15.3,1.3",)):
        wbflow(folder, "change", "2")
        assert "change new at 9.2,15.3,1.3: acknowledged by" in wbflow(folder).output
        assert wbflow(folder, *words, "--drop").exit_code == 0
        assert acknowledge.read(load_site(folder)) == ()


def test_a_slightly_shifted_change_keeps_its_name(folder: Path) -> None:
    wbflow(folder, "change", "2")
    record = of_night("2026-11-20", replace(CONTAINER, x=9.6))
    UnfinishedRun(WorkFolder.default_for(folder / "site.yaml", "yard"), record.run).publish(record, [], "")
    wbflow(folder, "change", "1", "--note", "still there")
    (known,) = acknowledge.read(load_site(folder))
    assert known.note == "still there"
    assert wbflow(folder, "change", "1", "--drop").exit_code == 0


@pytest.mark.parametrize("words", [("change", "7"), ("change",), ("change", "old", "at", "1,2,3", "x")])
def test_an_unknown_change_is_refused_with_a_list_of_changes(folder: Path, words: tuple[str, ...]) -> None:
    result = wbflow(folder, *words)
    assert result.exit_code == 2
    assert "its changes: change 1: new; change 2: new" in result.output


def test_run_json_contains_the_acknowledgements_of_changes(folder: Path) -> None:
    record = with_known(of_night("2026-11-20", CONTAINER), [Acknowledgement(CONTAINERS_NAME, "Ben", "2026-11-19")])
    again = RunRecord.from_json(record.to_json())
    assert changes_of(again)["1"].acknowledged == "acknowledged by Ben on 2026-11-19"


def test_the_page_lists_acknowledged_changes_last_and_counts_them_apart(tmp_path: Path) -> None:
    record = made_up_run.record(made_up_run.names(3), verdict=Verdict("good"), exit_code=0)
    changes = ChangesSummary(compared=True, count=2, changes={"1": CONTAINER, "2": VAN})
    known = [Acknowledgement(CONTAINERS_NAME, "Ben", "2026-12-01", note="for the winter")]
    page = made_up_run.page(tmp_path, with_known(replace(record, results={"changes": changes}), known), nights=0).read_text()
    first, _, _ = page.partition('class="stage"')
    assert "2 changes since the reference (2 new); 1 acknowledged." in first
    assert first.index('data-mark="2"') < first.index('class="finding change known"') < first.index('data-mark="1"')
    assert "acknowledged by Ben on 2026-12-01: for the winter" in first
    assert page.count('class="card thing known"') == 1


def test_a_run_records_acknowledged_changes_that_have_another_number(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    """The toy site compares nothing, so its nights get made-up changes when they are judged."""
    toy.backend = "threading"
    nights = iter([(VAN, CONTAINER), (replace(CONTAINER, x=9.5), VAN)])
    judged = rules.judge_run

    def judge_run(record: RunRecord, *rest: Any) -> RunRecord:
        return replace(judged(record, *rest), results=of_night(record.date, *next(nights)).results)

    monkeypatch.setattr(publish, "judge_run", judge_run)
    assert "acknowledged" not in toy.run()["changes"]["changes"]["2"]
    assert wbflow(toy.folder, "change", "2", "--note", "for the winter").exit_code == 0
    changes = toy.run()["changes"]["changes"]
    assert "for the winter" in changes["1"]["acknowledged"]
    assert "acknowledged" not in changes["2"]
    assert "for the winter" in (toy.work / "runs" / "latest" / "report.html").read_text()
