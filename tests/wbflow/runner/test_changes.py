"""A capture that is replaced while the night is worked on is never kept under what it was before."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.helpers.toy_site import HELPERS, ToySite
from wbflow.cache.digests import Digests


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
    toy.run()
    replaced = toy.cloud
    monkeypatch.undo()
    monkeypatch.syspath_prepend(str(HELPERS))
    toy.run()
    assert (toy.cloud, toy.ran()) == (replaced, set())
    toy.capture("roof").write_text(before)
    toy.run()
    assert toy.cloud != replaced
    assert "frames roof" in toy.ran()


def test_a_file_that_keeps_changing_costs_its_camera_only(toy: ToySite, after_looking: Callable[[Path, int], None]) -> None:
    after_looking(toy.capture("roof"), 100)
    record = toy.run(code=3)
    roof = next(camera for camera in record["cameras"] if camera["id"] == "roof")
    assert "keeps changing" in roof["reason"]
    assert record["cloud"]["points"] == 2 * 3
