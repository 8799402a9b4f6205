"""A night with learned keypoints: each camera's picture is searched once, and any number of workers gives the same bytes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import wbflow
from tests.helpers.small_aliked import as_capture, untrained_weights
from wbflow.commands.demo import write_demo
from wbflow_stages.matching.onnx_model import onnx_session
from wbflow_stages.matching.onnx_model import run as run_model

pytest.importorskip("onnxruntime", reason="the extra wbflow[onnx] is not installed")


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """The small demo, four cameras and all of their pairs, with a small model."""
    write_demo(tmp_path / "yard", small=True, captures=1)
    file = tmp_path / "yard" / "site.yaml"
    as_capture(untrained_weights()).data.tofile(file.with_name("small.onnx"))
    with file.open("a") as text:
        text.write("stages: {features: {detector: onnx, model: small.onnx, max_keypoints: 300}}\n")
    return file


def test_each_picture_is_searched_once_for_all_pairs(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    searched = []

    def counted(name: str, *arguments: Any) -> list[Any]:
        searched.append(name)
        return run_model(name, *arguments)

    monkeypatch.setattr("wbflow_stages.matching.learned_keypoints.run", counted)
    finished = wbflow.run(site, jobs=1, backend="threading", until="matches")
    assert len(finished.pairs) == 6
    assert searched == ["small.onnx"] * 4
    wbflow.run(site, jobs=1, backend="threading", until="matches", force=["matches"])
    assert len(searched) == 4


def test_any_number_of_workers_gives_the_same_bytes(site: Path, tmp_path: Path) -> None:
    found = []
    for jobs in (1, 4):
        finished = wbflow.run(wbflow.load_site(site, tmp_path / f"work-{jobs}"), jobs=jobs, until="matches")
        made = [finished.receipt(task) for task in finished.tasks if task.stage in {"features", "matches"}]
        digests = sorted((receipt.task, receipt.key, receipt.digest) for receipt in made if receipt)
        found.append((digests, [(pair.name, pair.outcome, pair.reason) for pair in finished.pairs.values()]))
    assert found[0] == found[1]
    assert sum(task.startswith("features") for task, *_ in found[0][0]) == 4 and len(found[0][1]) == 6


def test_a_model_runs_on_one_thread() -> None:
    options = onnx_session(as_capture(untrained_weights())).get_session_options()
    assert options.intra_op_num_threads == options.inter_op_num_threads == 1
