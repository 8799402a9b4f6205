"""Site files: what is accepted, and that all mistakes are reported at once, each with its place and its remedy."""

from __future__ import annotations

import json
import unicodedata
from pathlib import Path
from typing import Literal

import pytest

from wbflow.site.load import load_site
from wbflow.site.models import Site
from wbflow.site.yaml_document import SiteError

GOOD = """\
site: yard
captures: {root: images, pattern: "{camera}.jpg"}
cameras:
  - gate
  - {id: roof, intrinsics: {hfov: 70.0}, pose: {position: [0, 0, 5], look_at: [10, 0, 0]}}
"""


def site_at(folder: Path, text: str = GOOD) -> Path:
    (folder / "images").mkdir(exist_ok=True)
    file = folder / "site.yaml"
    file.write_text(text)
    return file


def problems(folder: Path, text: str) -> list[str]:
    with pytest.raises(SiteError) as caught:
        load_site(site_at(folder, text))
    return [str(p).replace(f"{folder}/", "") for p in caught.value.problems]


def test_a_good_site_file_is_loaded(tmp_path: Path) -> None:
    site = load_site(site_at(tmp_path))
    assert [camera.id for camera in site.cameras] == ["gate", "roof"]
    assert site.work_folder.root == tmp_path / ".wbflow" / "yard"
    assert site.settings.resolution == 1600
    assert site.cameras[1].placement.R is not None
    assert site.cameras[1].placement.R[2] == pytest.approx([10 / 125**0.5, 0, -5 / 125**0.5])
    assert not site.posed


def test_a_folder_stands_for_the_site_file_in_it(tmp_path: Path) -> None:
    site_at(tmp_path)
    assert load_site(tmp_path).name == "yard"


def test_a_degree_above_the_limit_gives_a_note_and_an_invalid_one_an_error(tmp_path: Path) -> None:
    assert not load_site(site_at(tmp_path, GOOD + "pairs: {degree: 32}\n")).notes
    (note,) = load_site(site_at(tmp_path, GOOD + "pairs: {degree: 40}\n")).notes
    assert "pairs.degree: a view takes 32 pairs at most, its best, not 40" in str(note)
    for wrong in (0, 101, 2.5):
        (found,) = problems(tmp_path, GOOD + f"pairs: {{degree: {wrong}}}\n")
        assert "site.yaml:6:17: pairs.degree" in found and "give a whole number from 1 to 32" in found


def test_zones_are_polygons_with_a_name(tmp_path: Path) -> None:
    zones = "zones: [{name: quay, polygon: [[0, 0], [20, 0], [20, 8]], least_m: 0.5}]\n"
    site = load_site(site_at(tmp_path, GOOD + zones))
    assert site.setting("zones") == [{"name": "quay", "polygon": [[0, 0], [20, 0], [20, 8]], "least_m": 0.5}]
    assert load_site(site_at(tmp_path)).setting("zones") is None
    (found,) = problems(tmp_path, GOOD + "zones: [{name: quay, polygon: [[0, 0], [20, 0]]}]\n")
    assert "zones[0].polygon" in found
    assert "three corners" in found
    (found,) = problems(tmp_path, GOOD + zones.replace("least_m", "last_m"))
    assert "did you mean 'least_m'?" in found


def test_unquoted_numbers_are_camera_ids_as_written(tmp_path: Path) -> None:
    text = GOOD.replace("- gate", "- 0000").replace("cameras:", "pairs: {include: [[0000, roof]]}\ncameras:")
    site = load_site(site_at(tmp_path, text))
    assert site.cameras[0].id == "0000"
    assert site.settings.pairs.include == [["0000", "roof"]]


def test_environment_variables_expand_and_missing_ones_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SITE_IMAGES", str(tmp_path / "images"))
    assert (
        load_site(site_at(tmp_path, GOOD.replace("root: images", "root: '${SITE_IMAGES}'"))).captures.root == tmp_path / "images"
    )
    assert (
        load_site(site_at(tmp_path, GOOD.replace("root: images", "root: '${NOWHERE:-images}'"))).captures.root
        == tmp_path / "images"
    )
    (found,) = [p for p in problems(tmp_path, GOOD.replace("root: images", "root: '${NOWHERE}/x'")) if "NOWHERE" in p]
    assert found.startswith("site.yaml:2:18: captures.root: the environment variable NOWHERE is not set")


CASES = {
    "misspelt key": (
        "captures: {root: images, patern: x}",
        "2:26: captures.patern: unknown key 'patern'\n  did you mean 'pattern'?",
    ),
    "no pattern": ("captures: {root: images}", "2:11: captures: 'pattern' is missing"),
    "unknown field": ("captures: {root: images, pattern: '{cam}.jpg'}", "2:35: captures.pattern: {cam} is not known"),
    "no such folder": ("captures: {root: nowhere, pattern: x}", "2:18: captures.root: there is no folder"),
    "camera twice": ("  - gate\n  - gate", "5:5: cameras[1]: camera 'gate' is named twice, first on line 4"),
    "bad id": ("  - a b", "4:5: cameras[0]: 'a b' is not a camera id"),
    "dots": ("  - ..", "4:5: cameras[0]: '..' is not a camera id"),
    "half intrinsics": (
        "  - {id: a, intrinsics: {fy: 1, cx: 1, cy: 1, width: 4, height: 4}}",
        "4:25: cameras[0].intrinsics: 'fx' is missing\n  give fx, fy, cx, cy, width, height in pixels, or the horizontal "
        "field of view: intrinsics: {hfov: 72}",
    ),
    "images that are no list": (
        "  - {id: a, images: a.jpg}",
        "4:21: cameras[0].images: input should be a valid list, not 'a.jpg'\n  list file names below captures.root: images: "
        "[gate/1.jpg, gate/2.jpg]",
    ),
    "a word for a number": ("  - {id: a, intrinsics: {hfov: wide}}", "4:32: cameras[0].intrinsics.hfov: input should be"),
    "no position": ("  - {id: a, pose: {look_at: [0, 0, 0]}}", "4:19: cameras[0].pose: 'position' is missing"),
    "half a position": ("  - {id: a, pose: {latitude: 53, longitude: 9}}", "4:19: cameras[0].pose: 'height' is missing"),
    "two positions": (
        "  - {id: a, pose: {position: [0, 0, 0], latitude: 53}}",
        "4:19: cameras[0].pose: 'position' and 'latitude' are both given",
    ),
    "distance to nowhere": ("distances: [[gate, rof, 3]]", "2:20: distances[0][1]: there is no camera 'rof'"),
    "no distance": ("distances: [[gate, roof, far]]", "2:26: distances[0][2]: 'far' is not a distance in metres"),
    "seen once": (
        "control_points: [{position: [0, 0, 0], pixels: {gate: [1, 2]}}]",
        "2:18: control_points[0]: fewer than two cameras see it",
    ),
    "a sigma of nothing": (
        "  - {id: a, pose: {position: [0, 0, 9], rotation_sigma_deg: 0.3}}",
        "4:19: cameras[0].pose: 'rotation_sigma_deg' is given without a rotation",
    ),
    "a negative sigma": (
        "  - {id: a, pose: {position: [0, 0, 9], look_at: [1, 0, 9], rotation_sigma_deg: -1}}",
        "4:81: cameras[0].pose.rotation_sigma_deg: input should be greater than or equal to 0",
    ),
    "straight down": ("  - {id: a, pose: {position: [0, 0, 9], look_at: [0, 0, 0]}}", "4:19: cameras[0].pose: looks straight"),
    "skewed": (
        "  - {id: a, pose: {position: [0, 0, 9], rotation: [[1, 0, 0], [0, 1, 0], [0, 1, 0]]}}",
        "4:19: cameras[0].pose: 'rotation' is not a rotation",
    ),
    "no such mask": ("  - {id: a, mask: no.png}", "4:19: cameras[0].mask: there is no file"),
    "unknown stage": ("stages: {mtches: {}}", "2:10: stages.mtches: unknown stage 'mtches'\n  did you mean 'matches'?"),
    "unknown parameter": ("stages: {matches: {matchr: mutual}}", "2:20: stages.matches.matchr: unknown parameter 'matchr'"),
    "wrong choice": ("stages: {matches: {matcher: magic}}", "2:29: stages.matches.matcher: 'magic' is not one of"),
    "wrong type": ("stages: {disparity: {tolerance_px: wide}}", "2:36: stages.disparity.tolerance_px: 'wide' is not of type"),
    "no such function": ("stages: {matches: {use: 'nowhere:match'}}", "2:25: stages.matches.use: there is no module 'nowhere'"),
    "not optional": ("stages: {matches: off}", "2:19: stages.matches: matches cannot be switched off"),
    "no such camera": (
        "pairs: {include: [[gate, rof]]}",
        "2:26: pairs.include[0][1]: there is no camera 'rof'\n  did you mean 'roof'?",
    ),
    "impossible angles": ("pairs: {min_angle: 60.0, max_angle: 4.0}", "2:8: pairs: no angle is between"),
    "resolution elsewhere": (
        "stages: {frames: {resolution: 800}}",
        "2:19: stages.frames.resolution: 'resolution' is not set here",
    ),
    "a zero byte": (
        'captures: {root: images, pattern: "{camera}\\0.jpg"}',
        "2:35: captures.pattern: '{camera}\\x00.jpg' holds a zero byte",
    ),
    "a command with a zero byte": ('notify: {command: [mail, "a\\0b"]}', "2:26: notify.command[1]: 'a\\x00b' holds a zero byte"),
    "no function at all": ("stages: {matches: {use: ''}}", "2:25: stages.matches.use: '' is not a function"),
    "a function of Python's": (
        "stages: {matches: {use: 'subprocess:run'}}",
        "2:25: stages.matches.use: subprocess:run is in Python's standard library, and not a stage",
    ),
    "a method of Python's": (
        "stages: {matches: {matcher: 'subprocess:run'}}",
        "2:29: stages.matches.matcher: subprocess:run is in Python's standard library, and not a stage",
    ),
    "misspelt in a deep section": ("health: {drak: 5.0}", "2:10: health.drak: unknown key 'drak'\n  did you mean 'dark'?"),
    "not a number": ("resolution: many", "2:13: resolution: input should be a valid integer, not 'many'"),
}


@pytest.mark.parametrize("name", CASES)
def test_each_mistake_is_reported_with_place_name_and_remedy(tmp_path: Path, name: str) -> None:
    line, message = CASES[name]
    if line.startswith("captures"):
        text = GOOD.replace('captures: {root: images, pattern: "{camera}.jpg"}', line)
    elif line.startswith("  -"):
        text = GOOD[: GOOD.index("  - gate")] + line + "\n"
    else:
        text = GOOD.replace("site: yard\n", f"site: yard\n{line}\n")
    assert any(problem.startswith(f"site.yaml:{message}") for problem in problems(tmp_path, text)), problems(tmp_path, text)


def test_all_mistakes_are_reported_at_once(tmp_path: Path) -> None:
    text = "site: yard\ncaptures: {patern: x}\ncameras: [gate, gate]\nresolution: 3\nstages: {mtches: {}}\n"
    found = problems(tmp_path, text)
    assert len(found) == 4, "a misspelt key is one mistake: the right one is not missing besides"
    assert all("\n  " in problem for problem in found), "each with a remedy"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("site: {a: b: c}", "1:12: not valid YAML"),
        ("site: a\nsite: b\n", "2:1: site: 'site' is already given on line 1"),
        ("- a\n", "1:1: a site file is a mapping"),
        ("", "1:1: a site file is a mapping"),
        ("site: !!python/object:os.system {}\n", "1:7: not valid YAML"),
    ],
)
def test_files_that_are_not_site_files_are_refused(tmp_path: Path, text: str, message: str) -> None:
    assert any(problem.startswith(f"site.yaml:{message}") for problem in problems(tmp_path, text))


@pytest.mark.parametrize(("stated", "there"), [("NFC", "NFD"), ("NFD", "NFC")])
def test_a_folder_whose_accents_are_written_in_another_way_is_named(
    tmp_path: Path, stated: Literal["NFC", "NFD"], there: Literal["NFC", "NFD"]
) -> None:
    (tmp_path / unicodedata.normalize(there, "Höfe")).mkdir()
    (problem,) = problems(tmp_path, GOOD.replace("images", unicodedata.normalize(stated, "Höfe")))
    assert "is there, with its accents written in another way (Unicode NFC, NFD)" in problem


def test_a_missing_site_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(SiteError, match="cannot be read"):
        load_site(tmp_path / "none.yaml")


def calibrated(tmp_path: Path, entries: object) -> Site:
    (tmp_path / "cameras.json").write_text(json.dumps(entries))
    return load_site(site_at(tmp_path, GOOD + "calibration: cameras.json\n"))


def test_a_calibration_gives_lens_and_pose_unless_the_site_file_states_a_pose(tmp_path: Path) -> None:
    entry = {
        "K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]],
        "width": 640,
        "height": 480,
        "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "C": [1, 2, 3],
    }
    site = calibrated(tmp_path, {"gate.jpg": entry, "roof.jpg": entry})
    assert entry["K"] == site.cameras[0].lens.K
    assert site.cameras[0].posed
    assert entry["K"] == site.cameras[1].lens.K, "a field of view is only a guess beside a calibration"
    assert site.cameras[1].placement.C == [0, 0, 5]


def test_a_calibrated_pose_replaces_a_stated_position_without_rotation(tmp_path: Path) -> None:
    entry = {
        "K": [[5, 0, 3], [0, 5, 2], [0, 0, 1]],
        "width": 6,
        "height": 4,
        "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "C": [1, 2, 3],
    }
    (tmp_path / "cameras.json").write_text(json.dumps({"gate": entry, "roof": entry | {"metric": False}}))
    text = GOOD.replace(", look_at: [10, 0, 0]", "") + "calibration: cameras.json\n"
    site = load_site(site_at(tmp_path, text))
    assert site.posed
    assert site.cameras[1].placement.C == [1, 2, 3]
    assert site.cameras[1].placement.metric is False


def test_distances_and_control_points_refer_to_cameras_by_index(tmp_path: Path) -> None:
    text = GOOD + (
        "distances: [[roof, gate, 7]]\ncontrol_points: [{position: [1, 2, 3], pixels: {gate: [5, 6.5], roof: [7, 8]}}]\n"
    )
    survey = load_site(site_at(tmp_path, text)).survey
    assert survey.distances == ((1, 0, 7.0),)
    assert survey.points == ((1, 2, 3),)
    assert survey.observations == ((0, 0, 5, 6.5), (0, 1, 7, 8))


def test_sigmas_of_poses_come_from_the_site_file_or_the_calibration(tmp_path: Path) -> None:
    stated = "look_at: [10, 0, 0], position_sigma_m: 0.05, rotation_sigma_deg: 0.3}"
    entry = {"K": [[500, 0, 320], [0, 500, 240], [0, 0, 1]], "width": 640, "height": 480, "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}
    entry |= {"C": [1, 2, 3], "position_sigma_m": 0.04, "rotation_sigma_deg": 0.2}
    (tmp_path / "cameras.json").write_text(json.dumps({"gate": entry}))
    text = GOOD.replace("look_at: [10, 0, 0]}", stated) + "calibration: cameras.json\n"
    site = load_site(site_at(tmp_path, text))
    gate, roof = site.cameras
    assert (gate.placement.sigma_m, gate.placement.sigma_deg) == (0.04, 0.2) and gate.posed
    assert (roof.placement.sigma_m, roof.placement.sigma_deg) == (0.05, 0.3)


def test_distances_may_name_cameras_whose_ids_are_numbers(tmp_path: Path) -> None:
    text = GOOD.replace("- gate", "- 0000") + "distances: [[0000, roof, 7]]\n"
    assert load_site(site_at(tmp_path, text)).survey.distances == ((0, 1, 7.0),)


def test_geodetic_positions_become_east_north_up_from_the_first_one(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    text = GOOD[: GOOD.index("  - gate")] + (
        "  - {id: gate, pose: {latitude: 53.5, longitude: 10.0, height: 20.0}}\n"
        "  - {id: roof, pose: {latitude: 53.501, longitude: 10.0, height: 25.0, position_sigma_m: 0.5}}\n"
    )
    site = load_site(site_at(tmp_path, text))
    gate, roof = (camera.placement for camera in site.cameras)
    assert pytest.approx([0, 0, 0], abs=1e-6) == gate.C
    assert gate.sigma_m == 3.0, "as a plain receiver gives it"
    # 0.001 degrees of latitude are 111.3 m here; over this distance the ellipsoid curves down by 1 mm
    assert pytest.approx([0, 111.29, 5.0], abs=0.01) == roof.C
    assert roof.sigma_m == 0.5
    assert "+lat_0=53.5 +lon_0=10.0" in site.survey.crs
    assert not site.posed


def test_mixing_local_and_geodetic_positions_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("pyproj")
    text = GOOD.replace("  - gate", "  - {id: gate, pose: {latitude: 53.5, longitude: 10.0, height: 20.0}}")
    assert any("the transformation between the two is unknown" in problem for problem in problems(tmp_path, text))


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        (
            {"roof.jpg": {"K": [[5, 0, 3], [0, 5, 2], [0, 0, 1]], "width": 6, "height": 4}},
            "has no camera 'gate'; it has roof.jpg",
        ),
        ({"gate": {"K": [[5, 0, 3]], "width": 6, "height": 4}}, "gate.K must be 3x3 numbers"),
        ({"gate": {"width": 6, "height": 4}}, "gate lacks K"),
        (
            {"gate": {"K": [[5, 0, 3], [0, 5, 2], [0, 0, 1]], "width": 6, "height": 4, "R": [[2, 0, 0], [0, 1, 0], [0, 0, 1]]}},
            "gate.R",
        ),
        ([], "must map image names"),
    ],
)
def test_an_unusable_calibration_is_refused_with_a_reason(tmp_path: Path, entries: object, message: str) -> None:
    with pytest.raises(SiteError, match=r"cameras\.json") as caught:
        calibrated(tmp_path, entries)
    assert message in str(caught.value)


def test_the_template_names_every_key_and_is_valid_yaml(tmp_path: Path) -> None:
    from pydantic import BaseModel

    from wbflow.site import models
    from wbflow.site.yaml_document import load_yaml

    template = Path(__file__).parents[3] / "sites" / "template.yaml"
    text = template.read_text()
    load_yaml(template)
    sections = [kind for kind in vars(models).values() if isinstance(kind, type) and issubclass(kind, BaseModel)]
    assert len(sections) > 12
    for key in {key for section in sections for key in section.model_fields}:
        assert f"{key}:" in text, key


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("site: s\ncaptures:\n\troot: .\n", "indent with spaces: YAML allows no tabs there"),
        ("site: s\ncaptures: {root: ., pattern: {camera}.jpg}\n", "pattern: '{camera}.jpg'"),
        ("site: s\ncaptures:\n  pattern: {camera}/{date}.jpg\n", "pattern: '{camera}.jpg'"),
        ("site: s\ncaptures: {pattern: {camera}}\ncameras: [a, b]\n", "put it in quotes: pattern: '{camera}.jpg'"),
        ("site: s\ncaptures: {pattern: x}\ncameras: [a: b\n", "check indentation, colons and quotes"),
    ],
)
def test_common_yaml_mistakes_are_reported_with_a_correction(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "site.yaml").write_text(text)
    with pytest.raises(SiteError) as error:
        load_site(tmp_path)
    assert message in str(error.value)


def test_a_misspelt_folder_of_captures_is_reported_with_the_right_name(tmp_path: Path) -> None:
    (tmp_path / "captures").mkdir()
    (tmp_path / "site.yaml").write_text("site: s\ncaptures: {root: captrues, pattern: '{camera}.jpg'}\ncameras: [a, b]\n")
    with pytest.raises(SiteError, match=r"there is no folder .*captrues\s+did you mean 'captures'"):
        load_site(tmp_path)


def test_the_error_for_a_folder_without_a_site_file_suggests_wbflow_init(tmp_path: Path) -> None:
    with pytest.raises(SiteError, match=f"wbflow init {tmp_path}"):
        load_site(tmp_path)


FISHEYE = """\
site: yard
captures: {{root: images, pattern: "{{camera}}.jpg"}}
cameras:
  - gate
  - {{id: roof, model: fisheye, distortion: [0.01],
     intrinsics: {{fx: {f}, fy: {f}, cx: 319.5, cy: 179.5, width: 640, height: 360}},
     pose: {{position: [1, 2, 5], look_at: [10, 0, 0]}}, mask: roof.png}}
"""


def test_a_camera_too_wide_for_one_pinhole_is_split_into_views(tmp_path: Path) -> None:
    (tmp_path / "roof.png").write_bytes(b"")
    site = load_site(site_at(tmp_path, FISHEYE.format(f=204)))
    assert [camera.id for camera in site.cameras] == ["gate", "roof"]
    assert [view.id for view in site.views] == ["gate", "roof@1", "roof@2", "roof@3"]
    roof = site.cameras[1]
    for view in site.views[1:]:
        assert (view.camera, view.mask, view.placement.C, view.lens.K) == ("roof", roof.mask, [1.0, 2.0, 5.0], roof.lens.K)
        assert view.lens.camera == "roof"
    looks = [view.placement.R[2] for view in site.views[1:] if view.placement.R]
    assert roof.placement.R is not None
    assert looks[0] == pytest.approx(roof.placement.R[2])
    across = [sum(a * b for a, b in zip(roof.placement.R[0], look, strict=True)) for look in looks]
    assert across[1] < -0.8
    assert across[2] > 0.8


def test_a_camera_that_fits_one_pinhole_is_not_split(tmp_path: Path) -> None:
    (tmp_path / "roof.png").write_bytes(b"")
    site = load_site(site_at(tmp_path, FISHEYE.format(f=400)))
    assert site.views == site.cameras


LENS = "  - {id: mast, intrinsics: {%s}}\n"
SLIPS = {
    "decimal commas in a position": (
        GOOD + "  - {id: mast, pose: {position: [1,5, 2,0, 3,1]}}\n",
        "site.yaml:6:33: cameras[2].pose.position: holds 6 values, 3 belong there\n  write decimals with a point, not a comma",
    ),
    "one decimal comma": (
        GOOD + "distances: [[gate, roof, 12,4]]\n",
        "distances[0]: holds 4 values, 3 belong there\n  write decimals",
    ),
    "a decimal comma in braces": (GOOD + LENS % "hfov: 71,5", "unknown key '5'\n  write decimals with a point"),
    "a decimal comma in a line": (
        GOOD + "  - id: mast\n    intrinsics:\n      hfov: 71,5\n",
        "cameras[2].intrinsics.hfov: '71,5' is not a number\n  write decimals with a point, not a comma (1.5, not 1,5): 71.5",
    ),
    "a list that is just too long": (
        GOOD + "zones: [{name: quay, polygon: [[0, 0], [1, 2, 3, 4, 5], [2, 2]]}]\n",
        "zones[0].polygon[1]: holds 5 values, 2 belong there\n  give name",
    ),
    "no space after the first colon": (
        GOOD.replace("site: ", "site:"),
        "site.yaml:1:1: there is no space after the colon of 'site'\n  write site: yard",
    ),
    "no space after a colon above empty lines and comments": (
        GOOD.replace("site: yard\n", "# The yard.\nsite:yard\n\n# One folder for each camera.\n\n# Several captures a night.\n"),
        "site.yaml:2:1: there is no space after the colon of 'site'\n  write site: yard",
    ),
    "no space after a later colon": (
        GOOD + "resolution:1600\npairs: {}\n",
        "site.yaml:6:1: there is no space after the colon of 'resolution'",
    ),
    "no space in braces": (GOOD + LENS % "hfov:70", "unknown key 'hfov:70'\n  write a space after the colon: hfov: 70"),
    "an equals sign": (
        GOOD + "resolution = 1600\n",
        "site.yaml:6:1: 'resolution' is followed by '=', not a colon\n  write resolution: 1600",
    ),
    "an unknown id": (
        GOOD + "distances: [[gate, rof, 3]]\n",
        "distances[0][1]: there is no camera 'rof'\n  did you mean 'roof'?",
    ),
    "an id twice": (GOOD + "distances: [[gate, gate, 3]]\n", "distances[0]: gate has no distance from itself"),
    "an id in another script": (
        GOOD + "  - Tor süd\n",
        "'Tor süd' is not a camera id\n  use letters, digits, '_', '.', '-' (not dots alone), at most 100, for example Tor-sud",
    ),
}


@pytest.mark.parametrize(("text", "message"), SLIPS.values(), ids=SLIPS)
def test_frequent_slips_are_told_as_what_they_are(tmp_path: Path, text: str, message: str) -> None:
    (found,) = problems(tmp_path, text)
    assert message in found
