"""A capture that is replaced while the night is worked on is never kept under what it was before."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.toy_site import HELPERS, ToySite
from wbflow.cache.artifact import file_digest
from wbflow.cache.digests import Digests
from wbflow.runner import loop


@pytest.fixture
def after_looking(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path, int], None]:
    """Has a file replaced right after its digest was taken, so many times."""

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


def test_what_it_holds_now_is_used_and_kept_under_its_own_digest(
    toy: ToySite, after_looking: Callable[[Path, int], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    before = toy.capture("roof").read_text()
    after_looking(toy.capture("roof"), 1)
    (finding,) = toy.run(code=3)["verdict"]["findings"]
    assert (finding["kind"], finding["subject"]) == ("captures-in-motion", ["roof"])
    replaced = toy.cloud
    monkeypatch.undo()
    monkeypatch.syspath_prepend(str(HELPERS))
    toy.run()
    assert (toy.cloud, toy.ran()) == (replaced, set())
    toy.capture("roof").write_text(before)
    toy.run()
    assert toy.cloud != replaced
    assert "frames roof" in toy.ran()


def test_what_is_replaced_after_it_was_read_is_named_with_the_bytes_that_were_used(
    toy: ToySite, monkeypatch: pytest.MonkeyPatch
) -> None:
    used = file_digest(toy.capture("roof"))
    work = loop.work

    def work_then_replace(*arguments: Any) -> Any:
        worked = work(*arguments)
        toy.capture("roof").write_text("a view from roof, and more of it")
        return worked

    monkeypatch.setattr("wbflow.outcome.publish.work", work_then_replace)
    record = toy.run(code=3)
    (finding,) = record["verdict"]["findings"]
    assert (finding["kind"], finding["subject"]) == ("captures-in-motion", ["roof"])
    assert record["cameras"][1]["captures"] == {"roof.txt": used}


def test_a_file_that_keeps_changing_costs_its_camera_only(toy: ToySite, after_looking: Callable[[Path, int], None]) -> None:
    after_looking(toy.capture("roof"), 100)
    record = toy.run(code=3)
    roof = next(camera for camera in record["cameras"] if camera["id"] == "roof")
    assert "keeps changing" in roof["reason"]
    assert record["cloud"]["points"] == 2 * 3
