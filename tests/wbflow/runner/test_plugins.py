"""User functions: their inputs, what is known about their parameters, and where their modules may be."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator

import pytest

from tests.helpers.toy_site import ToySite

MATCHER = '''\
"""A matcher beside the site file."""

import numpy as np
from wbflow_stages.types import Matches

{extra}

def find({arguments}):
    """Match."""
    rows = np.zeros(1, np.int32)
    one = np.ones((1, 2))
    return Matches({x1}, one, rows, rows, np.ones(1, np.float32), np.eye(2)[None], {left}.view, {right}.view)
'''


@pytest.fixture(autouse=True)
def _forget() -> Iterator[None]:
    """Unload the modules beside a site file, so that the next test does not get them."""
    before = list(sys.path)
    yield
    sys.path[:] = before
    for name in ("plugin", "modes", "other", "numpy_too"):
        sys.modules.pop(name, None)


def matcher(toy: ToySite, use: str = "plugin:find", **parameters: object) -> None:
    """Make the toy site match its pairs with a user function."""
    site = json.loads(toy.file.read_text())
    site["stages"]["matches"] = {"use": use, **parameters}
    toy.file.write_text(json.dumps(site, indent=1))


def write(
    toy: ToySite, arguments: str, extra: str = "", x1: str = "one", sides: str = "left right", file: str = "plugin"
) -> None:
    left, right = sides.split()
    text = MATCHER.format(arguments=arguments, extra=extra, x1=x1, left=left, right=right)
    (toy.folder / f"{file}.py").write_text(text)


def first_match(toy: ToySite) -> float:
    """x of the first match of the pair gate--roof."""
    from wbflow.cache import artifact

    (file,) = (toy.work / "cache" / "matches" / "gate--roof").glob("*.wbf")
    return float(artifact.decode(file.read_bytes()).x1[0, 0])


def parameters(toy: ToySite) -> dict[str, object]:
    (file,) = (toy.work / "cache" / "matches" / "gate--roof").glob("*.json")
    found: dict[str, object] = json.loads(file.read_text())["preimage"]["parameters"]
    return found


def problem(toy: ToySite, command: str = "check") -> str:
    """The error message with which a command refuses the site file."""
    result = toy.wbflow(command)
    assert result.returncode == 2
    return result.stderr


@pytest.mark.parametrize("jobs", ["1", "2"])
def test_a_module_beside_the_site_file_is_found_in_worker_processes(toy: ToySite, jobs: str) -> None:
    write(toy, "left, right, *, shift: float = 1.0", x1="one * shift")
    matcher(toy, shift=5.0)
    done = toy.wbflow("run", "--jobs", jobs)
    assert done.returncode == 0, done.stderr
    assert first_match(toy) == 5.0


def test_an_installed_package_is_not_shadowed_by_a_file_beside_the_site(toy: ToySite) -> None:
    write(toy, "left, right", file="json")
    matcher(toy, "json:find")
    assert "module 'json' has no function 'find'" in problem(toy)


def test_a_change_in_a_helper_beside_the_site_file_runs_the_stage_again(toy: ToySite) -> None:
    (toy.folder / "other.py").write_text("SHIFT = 2.0\n")
    write(toy, "left, right", extra="from other import SHIFT", x1="one * SHIFT")
    matcher(toy)
    assert toy.wbflow("run", "--jobs", "1").returncode == 0
    (toy.folder / "other.py").write_text("SHIFT = 3.0\n")
    assert toy.wbflow("run", "--jobs", "1").returncode == 0
    assert "matches gate--roof" in toy.ran()


def test_a_default_that_is_not_a_literal_applies_and_is_part_of_the_key(toy: ToySite) -> None:
    write(toy, "left, right, *, ratio: float = BASE * 0.4", extra="BASE = 2.0", x1="one * ratio")
    matcher(toy)
    assert toy.wbflow("run", "--jobs", "1").returncode == 0
    assert first_match(toy) == pytest.approx(0.8)
    assert parameters(toy) == {"ratio": "default BASE * 0.4"}
    write(toy, "left, right, *, ratio: float = BASE * 0.4", extra="BASE = 3.0", x1="one * ratio")
    toy.wbflow("run", "--jobs", "1")
    assert "matches gate--roof" in toy.ran()


def test_a_parameter_without_a_literal_default_can_be_set_and_is_checked(toy: ToySite) -> None:
    write(toy, "left, right, *, ratio: float = BASE * 0.4", extra="BASE = 2.0", x1="one * ratio")
    matcher(toy, ratio=7.0)
    assert toy.wbflow("run", "--jobs", "1").returncode == 0
    assert first_match(toy) == 7.0
    matcher(toy, ratio="wide")
    assert "'wide' is not of type float\n  the default is BASE * 0.4" in problem(toy)


@pytest.mark.parametrize(
    ("line", "annotation"),
    [
        ("from modes import Mode", "Mode"),
        ("from modes import Mode as M", "M | None"),
        ("import modes", "modes.Mode"),
        ("from modes import *", "Mode"),
        ("from modes import Mode", '"Mode"'),
    ],
)
def test_imported_choices_of_a_parameter_are_checked(toy: ToySite, line: str, annotation: str) -> None:
    (toy.folder / "modes.py").write_text('from typing import Literal\nMode = Literal["fast", "good"]\n')
    write(toy, f'left, right, *, mode: {annotation} = "fast"', extra=line)
    matcher(toy, mode="best")
    assert "'best' is not one of fast, good" in problem(toy)
    matcher(toy, mode="good")
    assert toy.wbflow("status").returncode == 0


def test_a_matcher_may_take_only_the_frames(toy: ToySite) -> None:
    write(toy, "left_frame, right_frame", x1="one * (left_frame.image[0, 0, 0] / 40)", sides="left_frame right_frame")
    matcher(toy)
    done = toy.wbflow("run", "--jobs", "1")
    assert done.returncode == 0, done.stderr
    assert first_match(toy) > 0
    assert "\ntasks   40 cached" in toy.wbflow("run", "--jobs", "1").stdout
    toy.capture("roof").write_text("another view")
    toy.wbflow("run", "--jobs", "1")
    assert "matches gate--roof" in toy.ran()
    assert "matches gate--crane" not in toy.ran()


def test_a_user_method_gets_the_frames_from_the_stage(toy: ToySite) -> None:
    write(toy, "left_frame, right_frame, *, shift: float = STEP * 2", "STEP = 1.0", "one * shift", "left_frame right_frame")
    site = json.loads(toy.file.read_text())
    site["stages"]["matches"] = {"matcher": "plugin:find", "min_matches": 1}
    toy.file.write_text(json.dumps(site, indent=1))
    done = toy.wbflow("run", "--jobs", "1")
    assert done.returncode == 0, done.stderr
    assert first_match(toy) == 2.0
    receipt = next((toy.work / "cache" / "matches" / "gate--roof").glob("*.json"))
    assert set(json.loads(receipt.read_text())["preimage"]["inputs"]) == {"left", "right", "left_frame", "right_frame"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            "left, right, depth",
            "has the required argument 'depth', which is not an available input; matches can provide left, left_frame, ",
        ),
        ("left, right, ratio=0.8", "has 'ratio' among its inputs"),
        ("left, right, /", "takes 'left' by position only"),
        ("left, right, *, shift", "has 'shift' without a default"),
    ],
)
def test_a_wrong_signature_is_refused_with_its_place_in_the_site_file(toy: ToySite, arguments: str, message: str) -> None:
    write(toy, arguments)
    matcher(toy)
    reported = problem(toy)
    assert message in reported
    assert "site.yaml:" in reported
    assert "stages.matches.use: " in reported


def test_missing_functions_and_invalid_modules_are_named_in_the_error(toy: ToySite) -> None:
    write(toy, "left, right")
    matcher(toy, "plugin:search")
    assert "module 'plugin' has no function 'search'; it has find" in problem(toy)
    assert problem(toy, "run") == problem(toy)
    (toy.folder / "plugin.py").write_text("def find(:\n")
    matcher(toy)
    assert "plugin.py:1: " in problem(toy)


def test_a_renamed_function_in_a_moved_file_keeps_the_cache(toy: ToySite) -> None:
    write(toy, "left, right, *, shift: float = 1.0", x1="one * shift")
    matcher(toy)
    assert toy.wbflow("run", "--jobs", "1").returncode == 0
    text = (toy.folder / "plugin.py").read_text()
    (toy.folder / "other.py").write_text(text.replace("def find", "def search"))
    (toy.folder / "plugin.py").unlink()
    matcher(toy, "other:search")
    assert toy.wbflow("run", "--jobs", "1").returncode == 0
    assert toy.ran() == set()


def test_the_pose_stage_gets_frames_only_if_a_stated_pose_is_rough(toy: ToySite) -> None:
    (toy.folder / "plugin.py").write_text(
        "def solve(views, placements, geometries, survey, frames_if_rough):\n"
        "    raise ValueError(f'frames of {sorted(frames_if_rough)}')\n"
    )
    pose = {"K": [[8, 0, 4], [0, 8, 4], [0, 0, 1]], "width": 8, "height": 8, "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}
    exact = {camera: pose | {"C": [k, 0, 0]} for k, camera in enumerate(toy.cameras)}
    rough = exact | {"roof": exact["roof"] | {"position_sigma_m": 0.05, "rotation_sigma_deg": 0.3}}
    site = json.loads(toy.file.read_text())
    site["stages"]["poses"] = {"use": "plugin:solve"}
    toy.file.write_text(json.dumps(site | {"calibration": "cameras.json"}))
    for stated, frames in ((exact, []), (rough, sorted(toy.cameras))):
        (toy.folder / "cameras.json").write_text(json.dumps(stated))
        run = toy.run("--until", "poses", code=None)["run"]
        assert f"frames of {frames}" in (toy.work / "runs" / run / "log.jsonl").read_text()


def test_matches_are_made_again_only_if_the_content_of_the_model_changes(toy: ToySite) -> None:
    write(toy, "left, right, model", x1="one * model.data.sum()")
    model, moved = toy.folder / "one.onnx", toy.folder / "two.onnx"
    model.write_bytes(bytes([3, 4]))
    matcher(toy, model="one.onnx")
    toy.run()
    assert first_match(toy) == 7.0
    assert parameters(toy) == {}
    model.rename(moved)
    matcher(toy, model="two.onnx")  # the same model under another name
    toy.run()
    assert not toy.ran()
    moved.write_bytes(bytes([3, 5]))
    toy.run()
    assert "matches gate--roof" in toy.ran()
    assert not any(task.startswith(("frames", "features")) for task in toy.ran())
    moved.unlink()
    assert "stages.matches.model: there is no file" in problem(toy)


def test_status_reports_that_the_reference_was_pinned_with_another_model(toy: ToySite) -> None:
    write(toy, "left, right, model", x1="one * model.data.sum()")
    (toy.folder / "one.onnx").write_bytes(bytes([3, 4]))
    matcher(toy, model="one.onnx")
    toy.run()
    assert toy.wbflow("pin").returncode == 0
    toy.run()
    assert "it was pinned with another" not in toy.wbflow("status").stderr
    (toy.folder / "one.onnx").write_bytes(bytes([3, 5]))
    assert "it was pinned with another model in matches" in toy.wbflow("status").stderr


@pytest.mark.parametrize(
    ("x1", "fault"),
    [
        ("one.astype(np.float32)", "x1 is float32 (1, 2); float64 (n, 2) is needed"),
        ("[[1.0, 1.0]]", "x1 is a list; an array, float64 (n, 2), is needed"),
        ("one[0]", "x1 is float64 (2,); float64 (n, 2) is needed"),
        ("np.ones((2, 2))", "x2 is float64 (1, 2); float64 (n, 2) is needed, with n = 2"),
        ("one * np.nan", "x1 has 2 of 2 values that are not finite"),
        ("one * 1000", "x1 has 1 of 1 points outside of the 300 x 300 picture, such as (1000, 1000)"),
    ],
)
def test_a_wrong_result_names_the_function_and_the_field(toy: ToySite, x1: str, fault: str) -> None:
    write(toy, "left, right", x1=x1)
    matcher(toy)
    done = toy.wbflow("run", "--jobs", "1", "--until", "geometry")
    assert f"plugin:find returned a wrong Matches: {fault}" in done.stdout + done.stderr


def test_a_result_of_another_type_names_what_is_needed(toy: ToySite) -> None:
    (toy.folder / "plugin.py").write_text("def find(left, right):\n    return [1, 2]\n")
    matcher(toy)
    done = toy.wbflow("run", "--jobs", "1", "--until", "geometry")
    assert "plugin:find returned list; Matches or Rejected is needed" in done.stdout + done.stderr
