"""Which cameras are inputs of a task."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

from wbflow.pipeline.stages import PAIRS, stage_named
from wbflow.runner.state import State
from wbflow.runner.subjects import Subjects
from wbflow.task import Task


def subjects(cameras: str, pairs: list[str]) -> Subjects:
    """The subjects of a site with these pairs; each camera's name is one letter."""
    graph = stage_named(PAIRS)
    receipt: Any = SimpleNamespace(figures={"pairs": [list(pair) for pair in pairs]})
    site: Any = SimpleNamespace(views=[SimpleNamespace(id=camera) for camera in cameras])
    return Subjects(cast(Any, site), {Task(graph.name): State("ran", receipt=receipt)})


def test_cameras_near_a_camera_are_its_partners_and_their_partners() -> None:
    row = subjects("abcde", ["ab", "bc", "cd", "de"])
    assert row.around("a") == ["b"] and row.near("a") == ["b", "c"]
    assert row.near("c") == ["a", "b", "d", "e"]


def test_all_partners_are_near_a_camera_and_others_up_to_eight_in_all() -> None:
    hub = subjects("abcdefghijkl", [f"a{c}" for c in "bcdefghijkl"])
    assert len(hub.near("a")) == 11, "all its partners"
    assert hub.near("l") == list("abcdefgh"), "of those that share as many partners the first"
    more = subjects("abcdefghijkl", [f"a{c}" for c in "bcdefghijkl"] + ["bk", "bl"])
    assert "k" in more.near("l"), "two ways lead there"
