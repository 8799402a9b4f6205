"""A run with a stop time ends in good order and publishes what is ready."""

from __future__ import annotations

import datetime
from pathlib import Path

import pytest

import wbflow
from tests.helpers.toy_site import HELPERS, ToySite


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ToySite:
    monkeypatch.syspath_prepend(str(HELPERS))
    return ToySite(tmp_path / "site", ["a", "b", "c"])


def run_late(toy: ToySite, *force: str, until: str | None = None) -> wbflow.Run:
    over = datetime.datetime.now() - datetime.timedelta(seconds=1)
    return wbflow.run(toy.file, backend="threading", jobs=1, force=force, until=until, stop_at=over)


def test_a_stopped_run_makes_a_cloud_of_finished_pairs_and_names_the_rest(toy: ToySite) -> None:
    wbflow.run(toy.file, backend="threading", jobs=1, until="disparity")
    run = run_late(toy, "disparity a--b")
    assert run.record.exit_code == 3
    assert run.record.cloud is not None
    assert run.record.verdict is not None
    (found,) = (finding for finding in run.record.verdict.findings if finding.kind == "stopped")
    assert "was to stop at" in found.text
    assert run.pairs["a--b"].code == "stopped"
    assert run.pairs["b--c"].ok


def test_a_run_stopped_before_any_result_has_no_cloud_and_can_be_resumed(toy: ToySite) -> None:
    run = run_late(toy)
    assert run.record.exit_code == 1
    assert run.record.cloud is None
    assert run.record.verdict is not None
    assert run.record.verdict.findings[0].kind == "stopped"
    again = wbflow.run(toy.file, backend="threading", jobs=1)
    assert again.record.exit_code == 0, "and the next run goes on from there"


def test_a_stop_time_does_not_affect_a_run_that_ends_before_it(toy: ToySite) -> None:
    later = datetime.datetime.now() + datetime.timedelta(hours=1)
    run = wbflow.run(toy.file, backend="threading", jobs=1, stop_at=later)
    assert run.record.exit_code == 0
