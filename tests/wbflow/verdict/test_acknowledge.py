"""Acknowledged findings neither degrade a night nor notify anybody until they expire."""

from __future__ import annotations

import datetime
import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from tests.helpers.toy_site import ToySite
from wbflow.cli.main import main
from wbflow.site.models import Site

LOST = ("camera-lost", "crane")


@pytest.fixture
def site(toy: ToySite, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ToySite:
    """A site whose camera `crane` delivers no captures; today is the 1st of November."""
    monkeypatch.setattr(Site, "today", lambda site: datetime.date(2026, 11, 1))
    toy.capture("crane").unlink()
    toy.dated, toy.backend = True, "threading"
    toy.keys = {"notify": {"command": f"echo $WBFLOW_EVENT >> {tmp_path / 'calls'}"}}
    toy.write()
    for night in ("2026-11-01", "2026-11-02", "2026-11-03"):
        toy.night(night)
        toy.capture("crane", night).unlink()
    return toy


def events(site: ToySite) -> list[str]:
    calls = site.folder.parent / "calls"
    return calls.read_text().split() if calls.exists() else []


def acknowledge(site: ToySite, *words: str) -> Result:
    return CliRunner().invoke(main, ["acknowledge", str(site.file), *words], env=site.env())


def test_an_acknowledged_finding_neither_degrades_a_night_nor_notifies(site: ToySite) -> None:
    site.run("--date", "2026-11-01", code=3)
    assert "camera-lost crane" in acknowledge(site).output
    done = acknowledge(site, *LOST, "--until", "2026-11-02", "--note", "new cable")
    assert done.exit_code == 0, done.output
    before = events(site)
    record = site.run("--date", "2026-11-02", code=0)
    (known,) = record["verdict"]["acknowledged"]
    assert (known["kind"], known["subject"]) == ("camera-lost", ["crane"])
    assert "until 2026-11-02: new cable" in known["remedy"]
    page = (site.work / "runs" / "latest" / "report.html").read_text()
    assert "new cable" in page
    assert events(site) == before, "nor is it back"
    assert not (site.work / "reference" / "reference.json").exists(), "a night without a camera is not pinned by itself"
    assert site.run("--date", "2026-11-03", code=3)["verdict"]["findings"], "it has expired"
    assert events(site)[-1] == "degraded"


def test_a_finding_counts_again_when_its_acknowledgement_is_dropped(site: ToySite) -> None:
    acknowledge(site, *LOST)
    site.run("--date", "2026-11-01", code=0)
    assert acknowledge(site, *LOST, "--drop").exit_code == 0
    site.run("--date", "2026-11-01", code=3)
    assert "is not acknowledged" in acknowledge(site, *LOST, "--drop").output


@pytest.mark.parametrize(
    ("words", "remedy"),
    [(("no-cloud",), "camera-lost"), (("camera-gone", "gate"), "camera-lost"), (("camera-lost", "tower"), "its cameras are")],
)
def test_findings_that_cannot_be_acknowledged_are_refused_with_a_remedy(
    site: ToySite, words: tuple[str, ...], remedy: str
) -> None:
    done = acknowledge(site, *words)
    assert done.exit_code == 2
    assert remedy in done.output


def test_a_faulty_file_of_acknowledgements_is_ignored_with_a_warning(site: ToySite) -> None:
    (site.folder / "site.acknowledged").write_text(json.dumps({"finding": 3}))
    record = site.run("--date", "2026-11-01", code=3)
    assert record["verdict"]["findings"]
    log = (site.work / "runs" / "latest" / "log.jsonl").read_text()
    assert "nothing is acknowledged" in log
