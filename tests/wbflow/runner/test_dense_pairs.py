"""Once the cameras are placed, the pairs for dense matching are selected anew."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from tests.helpers.toy_site import HELPERS, ToySite
from wbflow.cli.main import main

NEIGHBOURS = {"a--b", "b--c", "c--d"}
ALL = NEIGHBOURS | {"a--c", "a--d", "b--d"}


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ToySite:
    """Four cameras: only neighbours look alike, though every camera sees what all others see."""
    monkeypatch.syspath_prepend(str(HELPERS))
    parameters: dict[str, dict[str, Any]] = {"overlap": {"chain": True}, "rectify": {"use": "toy_stages:rectify_known"}}
    site = ToySite(tmp_path, ["a", "b", "c", "d"], parameters, backend="threading")
    share(site)
    return site


def share(site: ToySite, **stated: Any) -> None:
    """Switch on the stage `shared`, which estimates what placed cameras share, with these parameters."""
    site.write()
    content = json.loads(site.file.read_text())
    content["stages"]["shared"] = {"use": "toy_stages:share", **stated}
    site.file.write_text(json.dumps(content))


def ran(site: ToySite, stage: str) -> set[str]:
    return {task.partition(" ")[2] for task in site.ran() if task.split(" ")[0] == stage}


def test_dense_matching_includes_pairs_that_were_never_matched(toy: ToySite) -> None:
    record = toy.run()
    assert ran(toy, "matches") == NEIGHBOURS
    assert ran(toy, "disparity") == ALL
    pairs = {f"{pair['left']}--{pair['right']}": pair for pair in record["pairs"]}
    assert list(pairs) == sorted(ALL)
    assert {name for name, pair in pairs.items() if pair["matched"]} == NEIGHBOURS
    assert all(pair["dense"] and pair["outcome"] == "ok" and pair["density"] == 1.0 for pair in pairs.values())
    assert record["cloud"]["points"] == 2 * len(ALL)


def test_a_second_run_repeats_no_task_and_status_plans_none(toy: ToySite) -> None:
    toy.run()
    first = toy.cloud
    record = toy.run()
    assert record["tasks"]["ran"] == 0
    assert toy.cloud == first
    planned = CliRunner().invoke(main, ["status", str(toy.file), "--json"], env=toy.env())
    assert set(json.loads(planned.stdout)["totals"]) == {"cached"}


def test_the_matched_pairs_are_made_dense_if_the_shared_stage_is_rejected(toy: ToySite) -> None:
    share(toy, reject=True)
    toy.run(code=None)
    assert ran(toy, "disparity") == NEIGHBOURS


def test_matched_pairs_of_a_camera_without_a_pose_are_made_dense(toy: ToySite) -> None:
    toy.parameters["poses"] = {"leave_out": "d"}
    share(toy)
    record = toy.run(code=None)
    dense = {f"{pair['left']}--{pair['right']}" for pair in record["pairs"] if pair["dense"]}
    assert dense == {"a--b", "b--c", "a--c", "c--d"}


def test_pairs_are_not_selected_anew_if_every_pose_is_given(toy: ToySite) -> None:
    lens = {"fx": 8, "fy": 8, "cx": 4, "cy": 4, "width": 8, "height": 8}
    rows = [
        {"id": name, "intrinsics": lens, "pose": {"position": [k, 0, 2], "look_at": [k, 9, 0]}} for k, name in enumerate("abcd")
    ]
    content = json.loads(toy.file.read_text()) | {"cameras": rows}
    toy.file.write_text(json.dumps(content))
    record = toy.run(code=None)
    assert not {"shared", "dense_pairs"} & set(record["seconds"]["stages"])
    assert ran(toy, "disparity") == NEIGHBOURS
