"""The engine's own work grows linearly with the number of tasks, not quadratically; operations are counted, not seconds."""

from __future__ import annotations

import math
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.helpers.toy_site import HELPERS, ToySite

FEW, MANY = 8, 24
STEEPEST = 1.1


class Counted:
    """Counts function calls and fsyncs in the thread of a run."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.calls = self.syncs = 0
        sync = os.fsync

        def counted(descriptor: int) -> None:
            self.syncs += 1
            sync(descriptor)

        monkeypatch.setattr(os, "fsync", counted)

    def run(self, toy: ToySite) -> tuple[int, int, int]:
        """Numbers of calls, fsyncs and tasks of a run, in threads of this process."""

        def note(frame: Any, event: str, argument: Any) -> None:
            self.calls += event in {"call", "c_call"}

        self.calls = self.syncs = 0
        sys.setprofile(note)
        try:
            record = toy.run("--backend", "threading")
        finally:
            sys.setprofile(None)
        return self.calls, self.syncs, sum(record["tasks"].values())


def exponent(counts: tuple[int, int], tasks: tuple[int, int]) -> float:
    """Exponent of growth with the number of tasks, from the counts and the tasks of a small and a large site."""
    return math.log(counts[1] / counts[0]) / math.log(tasks[1] / tasks[0])


def test_calls_and_syncs_grow_linearly_with_the_number_of_tasks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(HELPERS)
    counted, found = Counted(monkeypatch), []
    for cameras in (FEW, MANY):
        toy = ToySite(tmp_path / str(cameras), [f"c{k}" for k in range(cameras)], keys={"pin": "none"})
        toy.run("--until", "frames", "--backend", "threading")  # imports and files that are read only once
        full, idle = counted.run(toy), counted.run(toy)
        (toy.folder / "captures" / "c1.txt").write_text("another view")
        found.append((full, idle, counted.run(toy)))
    for few, many in zip(*found, strict=True):
        calls, syncs, tasks = zip(few, many, strict=True)
        assert exponent(calls, tasks) < STEEPEST
        assert exponent(syncs, tasks) < STEEPEST
    assert found[1][1][1] < 30, "a night with nothing to do syncs no file for its tasks"
