"""Values that cannot be meant are refused, and unlikely ones are doubted, with the two numbers that do not go together."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from wbflow.site.load import load_site
from wbflow.site.models import Site
from wbflow.site.yaml_document import SiteError

LENS = "intrinsics: {fx: 900, fy: 905, cx: 640, cy: 360, width: 1280, height: 720}"
GATE = f"{{id: gate, {LENS}, pose: {{position: [0, 0, 5], look_at: [10, 10, 0]}}}}"
ROOF = f"{{id: roof, {LENS}, pose: {{position: [20, 0, 6], look_at: [10, 10, 0]}}}}"


def gate(keys: str, fx: str = "900, fy: 905") -> str:
    """The camera with further keys, or another focal length."""
    return GATE.replace("{id: gate,", f"{{id: gate, {keys},").replace("900, fy: 905", fx)


def site(folder: Path, gate: str = GATE, roof: str = ROOF, more: str = "") -> Site:
    file = folder / "site.yaml"
    file.write_text(f"site: s\ncaptures: {{root: ., pattern: '{{camera}}.jpg'}}\ncameras:\n- {gate}\n- {roof}\n{more}")
    return load_site(file)


def located(latitude: float, longitude: float, height: float = 12.0) -> str:
    return f"{{id: gate, {LENS}, pose: {{latitude: {latitude}, longitude: {longitude}, height: {height}}}}}"


ABOVE_ROOF = f"{{id: roof, {LENS}, pose: {{latitude: 53.5431, longitude: 9.9881, height: 14}}}}"
REFUSED: dict[str, tuple[dict[str, str], tuple[str, ...]]] = {
    "a focal length in millimetres": (
        {"gate": GATE.replace("fx: 900, fy: 905", "fx: 4.0, fy: 4.0")},
        ("fx is 4 ", "1280", "179.3 degrees"),
    ),
    "a focal length in metres": (
        {"gate": GATE.replace("fx: 900, fy: 905", "fx: 0.004, fy: 0.004")},
        ("fx is 0.004", "180.0 degrees"),
    ),
    "a fisheye in millimetres": (
        {"gate": gate("model: fisheye, distortion: [0.01]").replace("fx: 900, fy: 905", "fx: 1.8, fy: 1.8")},
        ("fx is 1.8", "40743"),
    ),
    "a distortion in percent": ({"gate": gate("distortion: [-21]")}, ("-21", "folded")),
    "a large distortion": ({"gate": gate("distortion: [300, 0, 0, 0, 0]")}, ("300", "0.2 ")),
    "a distortion in pixels": ({"gate": gate("distortion: [0.1, -2500000.0]")}, ("-2.5e+06",)),
    "a distortion of a fisheye": (
        {"gate": gate("model: fisheye, distortion: [-30]")},
        ("-30", "folded"),
    ),
    "privacy outside": (
        {"gate": gate("privacy: [[[2000, 10], [2100, 10], [2050, 90]]]")},
        ("2000, 10", "1280x720", "wholly"),
    ),
    "privacy below": (
        {"gate": gate("privacy: [[[20, 800], [100, 810], [50, 900]]]")},
        ("900", "1280x720", "wholly"),
    ),
    "privacy partly outside": (
        {"gate": gate("privacy: [[[1200, 10], [1400, 10], [1250, 90]]]")},
        ("1400", "1280x720", "a part"),
    ),
    "privacy that crosses itself": (
        {"gate": gate("privacy: [[[0, 0], [100, 100], [100, 0], [0, 100]]]")},
        ("from 0, 0 to 100, 100 crosses", "sides 1 and 3"),
    ),
    "latitude and longitude exchanged": (
        {"gate": located(9.9878, 53.5430), "roof": ABOVE_ROOF},
        ("camera gate", "km from another", "latitude: 53.543, longitude: 9.9878"),
    ),
    "a sign of the longitude": ({"gate": located(53.5430, -9.9878), "roof": ABOVE_ROOF}, ("km from another", "within 100 km")),
    "a degree": ({"gate": located(51.5430, 9.9878), "roof": ABOVE_ROOF}, ("223 km",)),
    "a camera in another system": (
        {"roof": ROOF.replace("[20, 0, 6]", "[565230.5, 5934100.2, 6]").replace("look_at: [10, 10, 0]", "look_at: [0, 0, 0]")},
        ("5,961 km",),
    ),
    "a distance in millimetres": ({"more": "distances: [[gate, roof, 20025]]\n"}, ("20025 m apart", "20.02 m apart")),
    "a distance in feet": ({"more": "distances: [[gate, roof, 65.7]]\n"}, ("65.7 m apart", "20.02 m apart")),
    "a distance in kilometres": ({"more": "distances: [[gate, roof, 0.02]]\n"}, ("0.02 m apart", "20.02 m apart")),
    "a zone that crosses itself": (
        {"more": "zones: [{name: quay, polygon: [[0, 0], [20, 8], [20, 0], [0, 8]]}]\n"},
        ("zone quay: the side from 0, 0 to 20, 8 crosses that from 20, 0 to 0, 8",),
    ),
    "a zone on a line": (
        {"more": "zones: [{name: quay, polygon: [[0, 0], [20, 0], [40, 0]]}]\n"},
        ("zone quay has an area of 0 m2",),
    ),
    "a box without a height": ({"more": "bounds: [[0, 0, 2], [20, 30, 2]]\n"}, ("20 x 30 x 0 m",)),
    "confidence in percent": (
        {"more": "stages: {fuse: {confidence: 70}}\n"},
        ("70 is not from 0 to 1", "0.6", "as percent: 0.7"),
    ),
    "a distortion of pixels beside a field of view": (
        {"gate": "{id: gate, intrinsics: {hfov: 72}, distortion: [-21, 0, 0, 0, 0]}"},
        ("cameras[0].distortion", "-21", "folded"),
    ),
    "a distance of a camera from itself": ({"more": "distances: [[roof, roof, 12]]\n"}, ("roof has no distance from itself",)),
    "confidence below zero": ({"more": "stages: {fuse: {confidence: -0.5}}\n"}, ("-0.5 is not from 0 to 1",)),
    "a share in percent": ({"more": "stages: {disparity: {min_density: 20}}\n"}, ("20 is not from 0 to 1", "as percent: 0.2")),
}


@pytest.mark.parametrize(("changed", "words"), REFUSED.values(), ids=REFUSED)
def test_what_cannot_be_meant_is_refused_with_both_numbers(
    tmp_path: Path, changed: dict[str, str], words: tuple[str, ...]
) -> None:
    if "latitude" in changed.get("gate", ""):
        pytest.importorskip("pyproj")
    with pytest.raises(SiteError) as caught:
        site(tmp_path, **changed)
    (problem,) = caught.value.problems
    assert problem.line >= 3 and problem.remedy
    for word in words:
        assert word in str(problem)


DOUBTED: dict[str, tuple[dict[str, str], tuple[str, ...]]] = {
    "a field of view in radians": ({"gate": "{id: gate, intrinsics: {hfov: 1.25}}"}, ("1.25 degrees", "71.6 degrees")),
    "a telescope": ({"gate": GATE.replace("fx: 900, fy: 905", "fx: 900000, fy: 905000")}, ("0.081 degrees",)),
    "pixels that are not square": ({"gate": GATE.replace("fy: 905", "fy: 90")}, ("fx is 900 and fy 90",)),
    "a principal point outside": ({"gate": GATE.replace("cx: 640, cy: 360", "cx: 640, cy: 960")}, ("640, 960", "1280x720")),
    "k3 in the place of p1": (
        {"gate": gate("distortion: [-0.2, 0.05, -0.12, 0]")},
        ("-0.12", "0.05"),
    ),
    "two cameras at one place": ({"roof": GATE.replace("gate", "roof")}, ("gate and roof are stated 0 m apart",)),
    "a world whose y is up": (
        {
            name: f"{{id: {name}, {LENS}, pose: {{position: [{x}, 5, 0], rotation: [[1, 0, 0], [0, -1, 0], [0, 0, -1]]}}}}"
            for name, x in (("gate", 0), ("roof", 20))
        },
        ("up is y in all 2 pictures (1.00)", "not z (0.00)"),
    ),
    "a control point outside": (
        {"more": "control_points: [{position: [10, 10, 0], pixels: {gate: [1500, 3], roof: [5, 3]}}]\n"},
        ("1500, 3", "1280x720"),
    ),
    "a command that does not exist": ({"more": "notify: {command: [sendmial, me]}\n"}, ("no program 'sendmial'",)),
    "a text for the shell that does not exist": (
        {"more": "notify: {command: 'A=1 sendmial -s x me | cat'}\n"},
        ("no program 'sendmial'",),
    ),
    "a command beside the site file": ({"more": "notify: {command: ./tell.sh}\n"}, ("no program './tell.sh'",)),
    "more cameras than there are": ({"more": "expect: {cameras: 4}\n"}, ("4 is expected, 2 is the most",)),
    "more pairs than there are": ({"more": "expect: {pairs: 70}\n"}, ("70 is expected, 1 is the most",)),
    "coverage in percent": ({"more": "expect: {coverage: 70}\n"}, ("70 is expected, 1 is the most",)),
    "points in percent": ({"more": "expect: {points: 70}\n"}, ("70 is a count of points", "0.7")),
    "a day in the future": ({"more": "expect: {since: 2999-01-01}\n"}, ("2999-01-01 is in the future",)),
    "bytes without a unit": ({"more": "keep: {bytes: 50}\n"}, ("0 kB", "10.0 MB")),
    "a zone smaller than its changes": (
        {"more": "zones: [{name: quay, polygon: [[0, 0], [2, 0], [2, 1]], least_m: 50}]\n"},
        ("2.24 m across", "50 m"),
    ),
    "a zone outside the bounds": (
        {"more": "bounds: [[0, 0, 0], [20, 30, 9]]\nzones: [{name: quay, polygon: [[100, 0], [120, 0], [120, 8]]}]\n"},
        ("zone quay at 100, 0",),
    ),
    "a parameter in another unit": ({"more": "stages: {features: {max_keypoints: 4}}\n"}, ("4 is far from the default, 6000",)),
}


@pytest.mark.parametrize(("changed", "words"), DOUBTED.values(), ids=DOUBTED)
def test_what_is_hardly_meant_is_doubted_with_both_numbers(
    tmp_path: Path, changed: dict[str, str], words: tuple[str, ...]
) -> None:
    (doubt,) = site(tmp_path, **changed).doubts
    assert doubt.line >= 3 and doubt.remedy
    for word in words:
        assert word in str(doubt)


GOOD = {
    "as it is": {},
    "a fisheye": {"gate": gate("model: fisheye, distortion: [0.03, -0.01, 0.002, 0]", "380, fy: 380")},
    "a strong lens": {"gate": gate("distortion: [-0.42, 0.2, 0.001, 0.0004, -0.05]", "700, fy: 700")},
    "a rational lens": {"gate": gate("distortion: [12.1, -8.4, 0.0002, -0.0003, 1.1, 12.4, -4.1, -1.5]")},
    "privacy in shares": {"gate": gate("privacy: [[[0.0, 0.7], [0.3, 0.65], [0.3, 1.0], [0.0, 1.0]]]")},
    "a distance within its error": {
        "roof": ROOF.replace("look_at: [10, 10, 0]", "look_at: [10, 10, 0], position_sigma_m: 5"),
        "more": "distances: [[gate, roof, 33]]\n",
    },
    "a zone that touches itself": {"more": "zones: [{name: quay, polygon: [[0, 0], [4, 0], [4, 4], [2, 0.0], [0, 4]]}]\n"},
    "a shell command": {"more": "notify: {command: 'if true; then echo x; fi'}\n"},
    "a variable": {"more": "notify: {command: '$HOME/tell'}\n"},
    "the shell": {"more": "notify: {command: [sh, -c, ls]}\n"},
    "usual expectations": {"more": "expect: {points: 0.5, pairs: 1, cameras: 2}\n"},
}


@pytest.mark.parametrize("changed", GOOD.values(), ids=GOOD)
def test_real_values_are_neither_refused_nor_doubted(tmp_path: Path, changed: dict[str, str]) -> None:
    assert site(tmp_path, **changed).doubts == ()


def test_a_calibration_is_examined_as_the_site_file_is(tmp_path: Path) -> None:
    entry = {"K": [[4, 0, 640], [0, 4, 360], [0, 0, 1]], "width": 1280, "height": 720}
    (tmp_path / "c.json").write_text(json.dumps({"gate": entry}))
    with pytest.raises(SiteError, match=r"site.yaml:4:3: cameras\[0\]: fx is 4 pixels"):
        site(tmp_path, gate="gate", more="calibration: c.json\n")
