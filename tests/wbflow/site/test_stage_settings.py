"""The section `stages` of a site file: only parameters of the chosen method, and names from earlier versions."""

from __future__ import annotations

import hashlib
import sys
from pathlib import Path

import pytest

from wbflow.pipeline.stages import STAGES
from wbflow.site.load import load_site
from wbflow.site.models import Site
from wbflow.site.published_models import PUBLISHED_MODELS, PublishedModel
from wbflow.site.stage_settings import RENAMED, Renamed
from wbflow.site.yaml_document import SiteError

SITE = """\
site: yard
captures: {root: ., pattern: "{camera}.jpg"}
cameras:
  - gate
  - roof
"""


def loaded(folder: Path, section: str) -> Site:
    file = folder / "site.yaml"
    file.write_text(f"{SITE}stages: {{{section}}}\n")
    return load_site(file)


def problem(folder: Path, section: str) -> str:
    with pytest.raises(SiteError) as caught:
        loaded(folder, section)
    return str(caught.value)


def test_a_parameter_of_other_methods_is_an_error_that_names_these(tmp_path: Path) -> None:
    reported = problem(tmp_path, "matches: {ratio: 0.7}")
    assert "site.yaml:6:20: stages.matches.ratio: 'ratio' is not read by the chosen matcher" in reported
    assert "leave it out, or choose matcher: hao2011-dominance or mutual or kdtree" in reported
    assert loaded(tmp_path, "matches: {matcher: mutual, ratio: 0.7}").stages["matches"].parameters["ratio"] == 0.7


def test_a_wrong_value_of_a_method_s_parameter_is_an_error(tmp_path: Path) -> None:
    assert "'wide' is not of type float" in problem(tmp_path, "matches: {matcher: mutual, ratio: wide}")


@pytest.mark.parametrize("stage", ["matches: {matcher: magic}", "rectify: {method: magic}", "disparity: {matcher: magic}"])
def test_an_unknown_method_is_an_error_that_lists_the_known_ones(tmp_path: Path, stage: str) -> None:
    reported = problem(tmp_path, stage)
    assert "'magic' is not one of " in reported
    assert "package.module:function" in reported


def test_a_user_method_is_found_beside_the_site_file(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def find(left_frame, right_frame, *, reach: int = 3):\n    return None\n")
    site = loaded(tmp_path, "matches: {matcher: 'mine:find', reach: 5}")
    assert site.stages["matches"].parameters == {"matcher": "mine:find", "reach": 5}
    (tmp_path / "mine.py").write_text("def find(left_frame, right_frame, depth, *, reach: int = 3):\n    return None\n")
    assert "mine:find has the required argument 'depth', which is not an available input" in problem(
        tmp_path, "matches: {matcher: 'mine:find'}"
    )


def test_old_names_and_values_are_understood_with_a_note(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    renamed = {"range": Renamed("range_margin"), "method": Renamed("method", {"seed": "hao2011"})}
    monkeypatch.setattr("wbflow.site.stage_settings.RENAMED", {"rectify": renamed})
    site = loaded(tmp_path, "rectify: {range: 0.2, method: seed}")
    assert site.stages["rectify"].parameters == {"range_margin": 0.2, "method": "hao2011"}
    first, second = map(str, site.notes)
    assert "site.yaml:6:20: stages.rectify.range: 'range' is written 'range_margin' now" in first
    assert "'method: seed' is written 'method: hao2011' now" in second
    assert loaded(tmp_path, "rectify: {method: hao2011}").notes == ()
    assert "is given as well" in problem(tmp_path, "rectify: {range: 0.2, range_margin: 0.1}")
    assert "'far' is not of type float" in problem(tmp_path, "rectify: {range: far}")


@pytest.mark.parametrize(
    ("section", "stage", "option", "value"),
    [
        ("matches: {matcher: literal}", "matches", "matcher", "hao2011"),
        ("matches: {matcher: dominant}", "matches", "matcher", "hao2011-dominance"),
        ("rectify: {method: literal}", "rectify", "method", "hao2011"),
    ],
)
def test_methods_keep_their_old_names_as_aliases(tmp_path: Path, section: str, stage: str, option: str, value: str) -> None:
    site = loaded(tmp_path, section)
    assert site.stages[stage].parameters[option] == value
    assert len(site.notes) == 1


def test_a_removed_parameter_is_ignored_with_a_note(tmp_path: Path) -> None:
    site = loaded(tmp_path, "fuse: {neighbours: 5, confidence: 0.6}")
    assert site.stages["fuse"].parameters == {"confidence": 0.6}
    (note,) = map(str, site.notes)
    assert "site.yaml:6:17: stages.fuse.neighbours: fuse has no 'neighbours' any more" in note


def test_parameters_of_a_user_function_are_not_renamed(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def detect(frame, *, keypoints: int = 3):\n    return None\n")
    site = loaded(tmp_path, "features: {use: 'mine:detect', keypoints: 5}")
    assert site.stages["features"].parameters == {"keypoints": 5}
    assert site.notes == ()


def test_every_new_name_of_a_renamed_parameter_exists(tmp_path: Path) -> None:
    """New names are parameters of the stage or of one of its methods; otherwise an old name would lead nowhere."""
    from wbflow.pipeline.binding import method_parameters
    from wbflow.pipeline.functions import FunctionReader

    reader = FunctionReader()
    for stage in STAGES:
        known = set(reader.signature(stage.function).parameters)
        known |= {name for parameters in method_parameters(stage, reader).values() for name in parameters}
        for old, row in RENAMED.get(stage.name, {}).items():
            assert row.current_name in known or old in known, (stage.name, old)


def test_a_missing_model_of_a_matcher_is_an_error_that_says_how_to_give_it(tmp_path: Path) -> None:
    reported = problem(tmp_path, "matches: {matcher: onnx}")
    assert "site.yaml:6:29: stages.matches.matcher: " in reported and "needs a file: model" in reported
    assert "give its path, relative to the site file: model: models/matcher.onnx" in reported
    assert "stages.matches.model: 5 is not a path" in problem(tmp_path, "matches: {matcher: onnx, model: 5}")


def test_a_misspelt_model_file_is_an_error_that_suggests_the_right_name(tmp_path: Path) -> None:
    (tmp_path / "glue.onnx").write_bytes(b"weights")
    reported = problem(tmp_path, "matches: {matcher: onnx, model: glu.onnx}")
    assert "site.yaml:6:42: stages.matches.model: there is no file" in reported and "did you mean 'glue.onnx'?" in reported
    settings = loaded(tmp_path, "matches: {matcher: onnx, model: glue.onnx, min_score: 0.3}").stages["matches"]
    assert settings.files == {"model": tmp_path / "glue.onnx"}
    assert settings.parameters == {"matcher": "onnx", "min_score": 0.3}


def test_a_model_of_another_matcher_is_an_error_that_names_that_matcher(tmp_path: Path) -> None:
    reported = problem(tmp_path, "matches: {model: glue.onnx}")
    assert "'model' is not read by the chosen matcher" in reported and "choose matcher: lightglue or onnx" in reported


def place_model(folder: Path, monkeypatch: pytest.MonkeyPatch, content: bytes = b"weights") -> Path:
    """A published model `tiny` for the stage features, whose file has this content on this machine."""
    published = PublishedModel("tiny", "features", "tests", "MIT", 7, hashlib.sha256(b"weights").hexdigest())
    monkeypatch.setitem(PUBLISHED_MODELS, "tiny", published)
    monkeypatch.setenv("WBFLOW_MODELS", str(folder / "models"))
    published.path.parent.mkdir(exist_ok=True)
    published.path.write_bytes(content)
    return published.path


def test_a_published_model_is_named_without_a_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = place_model(tmp_path, monkeypatch)
    settings = loaded(tmp_path, "features: {detector: onnx, model: tiny}").stages["features"]
    assert settings.files == {"model": path} and settings.parameters == {"detector": "onnx"}
    (tmp_path / "tiny").write_bytes(b"another")
    assert loaded(tmp_path, "features: {detector: onnx, model: ./tiny}").stages["features"].files == {"model": tmp_path / "tiny"}


def test_a_published_model_that_is_missing_or_not_whole_is_an_error_with_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = place_model(tmp_path, monkeypatch, b"weigh")
    section = "features: {detector: sift+onnx, model: tiny}"
    cut_off = problem(tmp_path, section)
    assert "site.yaml:6:49: stages.features.model: " in cut_off
    assert f"{path} is not the published file, or not all of it (5 bytes" in cut_off and "wbflow models get tiny" in cut_off
    path.unlink()
    missing = problem(tmp_path, section)
    assert f"tiny is not in {path.parent}" in missing and "wbflow models get tiny  (as the user that runs wbflow" in missing


def test_a_published_model_of_another_stage_or_a_misspelt_one_is_an_error_that_names_the_right_ones(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    place_model(tmp_path, monkeypatch)
    reported = problem(tmp_path, "matches: {matcher: onnx, model: tiny}")
    assert "tiny is a model for the stage features" in reported
    assert "for matches there are aliked-lightglue, sift-lightglue" in reported
    assert "did you mean 'aliked-n32'?" in problem(tmp_path, "features: {detector: onnx, model: alikedn32}")


def test_a_method_whose_package_is_not_installed_is_an_error_with_the_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mine.onnx").write_bytes(b"weights")
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    reported = problem(tmp_path, "features: {detector: onnx, model: mine.onnx}")
    assert "site.yaml:6:31: stages.features.detector: onnx needs ONNX Runtime, which is not installed" in reported
    assert "python -m pip install 'wbflow[onnx]'" in reported
    loaded(tmp_path, "features: {detector: sift}")
