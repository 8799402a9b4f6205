"""A capture that is replaced during a run is never cached under the digest of its former content."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.toy_site import HELPERS, ToySite
from wbflow.cache.checksum import file_digest
from wbflow.cache.memo import Digests
from wbflow.runner import loop
from wbflow.site import captures

OVERWRITTEN = "roof.txt was overwritten during the run; it was read as a whole, and `captures` has the digest of what was used"


def notes_of(record: dict[str, Any], name: str) -> list[str]:
    """The notes about the captures of a camera."""
    notes = next(list(camera["notes"]) for camera in record["cameras"] if camera["id"] == name)
    return [note for note in notes if note.startswith(f"{name}.txt")]


@pytest.fixture
def replace_after_hashing(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path, int], None]:
    """Makes a file be replaced right after its digest was taken, the first `times` times."""

    def arrange(path: Path, times: int) -> None:
        left = iter(range(times))
        look = Digests.of

        def of(digests: Digests, looked_at: Path) -> str:
            digest = look(digests, looked_at)
            if looked_at.resolve() == path.resolve() and (k := next(left, None)) is not None:
                path.write_text(f"replaced {k}")
            return digest

        monkeypatch.setattr(Digests, "of", of)

    return arrange


def test_a_capture_replaced_after_hashing_is_cached_under_its_new_digest(
    toy: ToySite, replace_after_hashing: Callable[[Path, int], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = toy.capture("roof").read_text()
    replace_after_hashing(toy.capture("roof"), 1)
    assert notes_of(toy.run(), "roof") == [OVERWRITTEN]
    replaced = toy.cloud
    monkeypatch.undo()
    monkeypatch.syspath_prepend(str(HELPERS))
    toy.run()
    assert (toy.cloud, toy.ran()) == (replaced, set())
    toy.capture("roof").write_text(before)
    toy.run()
    assert toy.cloud != replaced
    assert "frames roof" in toy.ran()


@pytest.mark.parametrize("dated", [True, False])
def test_a_capture_replaced_after_reading_is_recorded_with_the_digest_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dated: bool
) -> None:
    """It degrades the night only if file names contain the date; without dates, cameras overwrite their captures all the time."""
    monkeypatch.syspath_prepend(str(HELPERS))
    toy = ToySite(tmp_path / "site", ["gate", "roof", "mast-1", "crane"], dated=dated)
    used = file_digest(toy.capture("roof"))
    work = loop.run_tasks

    def work_then_replace(*arguments: Any) -> Any:
        worked = work(*arguments)
        toy.capture("roof").write_text("a view from roof, and more of it")
        return worked

    monkeypatch.setattr("wbflow.runner.life.run_tasks", work_then_replace)
    record = toy.run(code=3 if dated else 0)
    if dated:
        (finding,) = record["verdict"]["findings"]
        assert (finding["kind"], finding["subject"]) == ("captures-in-motion", ["roof"])
    assert notes_of(record, "roof") == ([] if dated else [OVERWRITTEN])
    assert record["cameras"][1]["captures"] == {toy.capture("roof").name: used}


def test_a_capture_that_is_being_written_is_waited_for(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(captures, "QUIET_SECONDS", 0.2)
    looks = iter(range(4))
    still = captures._is_written

    def written(path: Path) -> bool:
        if path == toy.capture("roof") and next(looks, None) is not None:
            path.write_text(f"{path.read_text()}, and more of it")
        return still(path)

    monkeypatch.setattr(captures, "_is_written", written)
    record = toy.run()
    assert record["cameras"][1]["captures"] == {"roof.txt": file_digest(toy.capture("roof"))}
    assert (toy.capture("roof").read_text().count("more of it"), notes_of(record, "roof")) == (4, [])


def test_a_capture_that_grows_for_ever_degrades_the_night(toy: ToySite, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(captures, "MOST_WAIT_SECONDS", 0.3)
    monkeypatch.setattr(captures, "_is_written", lambda path: path == toy.capture("roof"))
    work = loop.run_tasks

    def work_while_it_grows(*arguments: Any) -> Any:
        worked = work(*arguments)
        toy.capture("roof").write_text("a view from roof, and more of it")
        return worked

    monkeypatch.setattr("wbflow.runner.life.run_tasks", work_while_it_grows)
    (finding,) = toy.run(code=3)["verdict"]["findings"]
    assert (finding["kind"], finding["subject"]) == ("captures-in-motion", ["roof"])


def test_a_capture_that_keeps_changing_costs_only_its_camera(
    toy: ToySite, replace_after_hashing: Callable[[Path, int], None]
) -> None:
    replace_after_hashing(toy.capture("roof"), 100)
    record = toy.run(code=3)
    roof = next(camera for camera in record["cameras"] if camera["id"] == "roof")
    assert "keeps changing" in roof["reason"]
    assert record["cloud"]["points"] == 2 * 3
