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
    reported = json.loads(site.file.read_text())
    reported["stages"]["shared"] = {"use": "toy_stages:share", **stated}
    site.file.write_text(json.dumps(reported))


def ran(site: ToySite, stage: str) -> set[str]:
    return {task.partition(" ")[2] for task in site.ran() if task.split(" ")[0] == stage}


def test_a_pair_that_was_never_matched_is_made_dense(toy: ToySite) -> None:
    record = toy.run()
    assert ran(toy, "matches") == NEIGHBOURS
    assert ran(toy, "disparity") == ALL
    reported = {f"{pair['left']}--{pair['right']}": pair for pair in record["pairs"]}
    assert list(reported) == sorted(ALL)
    assert {name for name, pair in reported.items() if pair["matched"]} == NEIGHBOURS
    assert all(pair["dense"] and pair["outcome"] == "ok" and pair["density"] == 1.0 for pair in reported.values())
    assert record["cloud"]["points"] == 2 * len(ALL)


def test_a_second_night_repeats_nothing_and_plans_nothing(toy: ToySite) -> None:
    toy.run()
    first = toy.cloud
    record = toy.run()
    assert record["tasks"]["ran"] == 0
    assert toy.cloud == first
    planned = CliRunner().invoke(main, ["status", str(toy.file), "--json"], env=toy.env())
    assert set(json.loads(planned.stdout)["totals"]) == {"cached"}


def test_where_cameras_tell_nothing_the_matched_pairs_are_made_dense(toy: ToySite) -> None:
    share(toy, reject=True)
    toy.run(code=None)
    assert ran(toy, "disparity") == NEIGHBOURS


def test_a_pair_of_a_camera_that_is_not_placed_stays_as_it_was_matched(toy: ToySite) -> None:
    toy.parameters["poses"] = {"leave_out": "d"}
    share(toy)
    record = toy.run(code=None)
    reported = {f"{pair['left']}--{pair['right']}" for pair in record["pairs"] if pair["dense"]}
    assert reported == {"a--b", "b--c", "a--c", "c--d"}


def test_with_every_pose_given_nothing_is_chosen_anew(toy: ToySite) -> None:
    lens = {"fx": 8, "fy": 8, "cx": 4, "cy": 4, "width": 8, "height": 8}
    rows = [
        {"id": name, "intrinsics": lens, "pose": {"position": [k, 0, 2], "look_at": [k, 9, 0]}} for k, name in enumerate("abcd")
    ]
    reported = json.loads(toy.file.read_text()) | {"cameras": rows}
    toy.file.write_text(json.dumps(reported))
    record = toy.run(code=None)
    assert not {"shared", "dense_pairs"} & set(record["seconds"]["stages"])
    assert ran(toy, "disparity") == NEIGHBOURS
