"""A camera that is written in many dialects of calibration files is read as the same lens and pose; no key is ignored."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from wbflow.site.calibration import find_cameras, only_camera, read_calibration
from wbflow.site.calibration.calibrated import Calibrated
from wbflow.site.load import load_site
from wbflow.site.yaml_document import SiteError

WIDTH, HEIGHT = 640, 480
K = [[402.5, 0.0, 318.2], [0.0, 399.1, 243.7], [0.0, 0.0, 1.0]]
BROWN = [-0.21, 0.055, 0.0004, -0.0003, -0.008]
FISHEYE = [-0.02, 0.005, 0.001, -0.0002]
R = cv2.Rodrigues(np.array([1.9, -0.3, 0.4]))[0]
C = np.array([3.0, -12.5, 4.25])
T = -R @ C
C2W = np.vstack([np.column_stack([R.T, C]), [0, 0, 0, 1]])
W2C = np.linalg.inv(C2W)
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
LENS: dict[str, Any] = {"K": K, "width": WIDTH, "height": HEIGHT, "distortion": BROWN}


def as_camera(camera: Calibrated, distortion: list[float] | None = None, pixels: float = 1e-9) -> None:
    """Check that a camera is the one above."""
    lens, placement = camera.lens, camera.placement
    assert lens.K is not None and np.allclose(lens.K, K, atol=pixels)
    assert (lens.width, lens.height) == (WIDTH, HEIGHT)
    wanted = BROWN if distortion is None else distortion
    assert np.allclose(lens.distortion, wanted)
    assert placement.R is not None and np.allclose(placement.R, R, atol=1e-6)
    assert placement.C is not None and np.allclose(placement.C, C, atol=1e-5)


def write(path: Path, data: object) -> Path:
    path.write_text(json.dumps(data) if path.suffix == ".json" else yaml.safe_dump(data))
    return path


POSES: dict[str, dict[str, Any]] = {
    "R and C": {"R": R.tolist(), "C": C.tolist()},
    "R and t": {"R": R.tolist(), "t": T.tolist()},
    "R and a column T": {"R": R.tolist(), "T": T[:, None].tolist()},
    "a flat R": {"R": R.ravel().tolist(), "t": T.tolist()},
    "R, t and C that agree": {"R": R.tolist(), "t": T.tolist(), "C": C.tolist()},
    "rvec and tvec": {"rvec": cv2.Rodrigues(R)[0].ravel().tolist(), "tvec": T.tolist()},
    "columns rvec and tvec": {"rvec": cv2.Rodrigues(R)[0].tolist(), "tvec": T[:, None].tolist()},
    "rotation_vector": {"rotation_vector": cv2.Rodrigues(R)[0].ravel().tolist(), "translation_vector": T.tolist()},
    "rotation_matrix": {"rotation_matrix": R.tolist(), "translation_vector": T.tolist()},
    "R and position": {"R": R.tolist(), "position": C.tolist()},
    "w2c": {"w2c": W2C.tolist()},
    "a flat world_to_camera": {"world_to_camera": W2C.ravel().tolist()},
    "3x4": {"w2c": W2C[:3].tolist()},
    "c2w as OpenCV": {"c2w": C2W.tolist(), "convention": "opencv"},
    "c2w as OpenGL": {"c2w": (C2W @ OPENGL).tolist(), "convention": "opengl"},
    "w2c as OpenGL": {"w2c": (OPENGL @ W2C).tolist(), "convention": "OpenGL"},
}


@pytest.mark.parametrize("suffix", [".json", ".yaml"])
@pytest.mark.parametrize("pose", POSES.values(), ids=POSES)
def test_a_pose_may_be_written_in_many_ways(tmp_path: Path, pose: dict[str, Any], suffix: str) -> None:
    as_camera(read_calibration(write(tmp_path / f"cameras{suffix}", {"gate": LENS | pose}))["gate"])


def test_a_quaternion_of_colmap_is_a_rotation(tmp_path: Path) -> None:
    half = math.sqrt(0.5)
    entry = LENS | {"qvec": [half, 0, 0, half], "tvec": [1, 2, 3]}
    placement = read_calibration(write(tmp_path / "cameras.json", {"gate": entry}))["gate"].placement
    assert placement.R is not None and np.allclose(placement.R, [[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    assert placement.C is not None and np.allclose(placement.C, [-2, 1, -3])


POSE = POSES["R and t"]
BARE = {"width": WIDTH, "height": HEIGHT} | POSE
LENSES: dict[str, dict[str, Any]] = {
    "dist": {"K": K, "dist": BROWN},
    "distCoeffs": {"K": K, "distCoeffs": [BROWN]},
    "dist_coeffs": {"camera_matrix": K, "dist_coeffs": BROWN},
    "distCoef, as CMU has it": {"K": K, "distCoef": BROWN},
    "D": {"K": K, "D": BROWN},
    "flat": {"cameraMatrix": np.ravel(K).tolist(), "distCoeffs": BROWN},
    "focal lengths": {"fx": 402.5, "fy": 399.1, "cx": 318.2, "cy": 243.7, "distortion": BROWN},
    "RealSense": {"fx": 402.5, "fy": 399.1, "ppx": 318.2, "ppy": 243.7, "coeffs": BROWN, "model": "distortion.brown_conrady"},
    "one by one": {"K": K} | dict(zip(("k1", "k2", "p1", "p2", "k3"), BROWN, strict=True)),
    "in two": {"K": K, "radial_distortion": [BROWN[0], BROWN[1], BROWN[4]], "tangential_distortion": BROWN[2:4]},
    "the size in one": {"K": K, "dist": BROWN, "image_size": [WIDTH, HEIGHT], "width": None, "height": None},
    "the fit beside it": {"K": K, "dist": BROWN, "rms": 0.3, "reprojection_error": 0.31, "date": "2026-05-01", "_": 1},
}


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES)
def test_a_lens_may_be_written_in_many_ways(tmp_path: Path, lens: dict[str, Any]) -> None:
    as_camera(read_calibration(write(tmp_path / "cameras.json", {"gate": BARE | lens}))["gate"])
    alone = only_camera(read_calibration(write(tmp_path / "gate.json", BARE | lens)))
    assert alone is not None
    as_camera(alone)


def test_a_list_of_cameras_is_read_by_their_names(tmp_path: Path) -> None:
    entry = {**LENS, **POSE}
    listed = [{"name": "gate", **entry}, {"name": "roof", **LENS}]
    for data in (listed, {"cameras": listed}, {"version": 1, "cameras": {"gate": entry, "roof": LENS}}):
        cameras = read_calibration(write(tmp_path / "cameras.json", data))
        as_camera(cameras["gate"])
        assert cameras["roof"].placement.R is None


def transforms(lens: dict[str, Any], **frame: Any) -> dict[str, Any]:
    frames = [
        {"file_path": f"./images/{name}.png", "transform_matrix": (C2W @ OPENGL).tolist(), **frame} for name in ("gate", "roof")
    ]
    return {**lens, "aabb_scale": 16, "frames": frames}


NERF_LENS = {"fl_x": 402.5, "fl_y": 399.1, "cx": 318.7, "cy": 244.2, "w": WIDTH, "h": HEIGHT}
NERF_LENS |= {"camera_angle_x": 1.3, "k1": BROWN[0], "k2": BROWN[1], "p1": BROWN[2], "p2": BROWN[3], "k3": BROWN[4]}


@pytest.mark.parametrize("model", [{}, {"camera_model": "OPENCV"}])
def test_transforms_of_nerf_have_the_axes_of_opengl_and_pixels_from_the_corner(tmp_path: Path, model: dict[str, str]) -> None:
    cameras = read_calibration(write(tmp_path / "transforms.json", transforms(NERF_LENS | model)))
    assert list(cameras) == ["images/gate.png", "images/roof.png"]
    as_camera(cameras["images/gate.png"])


def test_transforms_of_nerf_may_have_a_lens_for_each_frame_or_a_fisheye_or_an_angle(tmp_path: Path) -> None:
    as_camera(read_calibration(write(tmp_path / "transforms.json", transforms({}, **NERF_LENS)))["images/gate.png"])
    fisheye = dict(zip(("k1", "k2", "k3", "k4"), FISHEYE, strict=True)) | {"camera_model": "OPENCV_FISHEYE"}
    lens = {key: value for key, value in NERF_LENS.items() if key[0] not in "kp"} | fisheye
    camera = read_calibration(write(tmp_path / "transforms.json", transforms(lens)))["images/gate.png"]
    assert camera.lens.model == "fisheye"
    as_camera(camera, FISHEYE)
    angle = {"camera_angle_x": 2 * math.atan(320 / 500), "w": WIDTH, "h": HEIGHT}
    lens_of_angle = read_calibration(write(tmp_path / "transforms.json", transforms(angle)))["images/gate.png"].lens
    assert np.allclose(np.array(lens_of_angle.K), [[500, 0, 319.5], [0, 500, 239.5], [0, 0, 1.0]])


def test_cameras_of_gaussian_splatting_are_read(tmp_path: Path) -> None:
    entry = {"id": 0, "img_name": "gate", "width": WIDTH, "height": HEIGHT, "position": C.tolist(), "rotation": R.T.tolist()}
    cameras = read_calibration(write(tmp_path / "cameras.json", [entry | {"fx": 402.5, "fy": 399.1}]))
    placement = cameras["gate"].placement
    assert placement.R is not None and placement.C is not None
    assert np.allclose(placement.R, R) and np.allclose(placement.C, C)
    assert cameras["gate"].lens.K == [[402.5, 0, 319.5], [0, 399.1, 239.5], [0, 0, 1]]


@pytest.mark.parametrize("suffix", [".yaml", ".xml", ".json"])
def test_opencv_files_with_a_pose_are_read(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"gate{suffix}"
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    file.write("calibration_time", "Mon May 4 2026")
    for name, value in {"image_width": WIDTH, "image_height": HEIGHT, "nframes": 12}.items():
        file.write(name, value)
    for name, matrix in {
        "camera_matrix": K,
        "distortion_coefficients": np.array(BROWN)[:, None],
        "R": R,
        "T": T[:, None],
    }.items():
        file.write(name, np.array(matrix))
    file.write("avg_reprojection_error", 0.4)
    file.release()
    as_camera(read_calibration(path)["gate"])


@pytest.mark.parametrize("names", [("M1", "D1", "M2", "D2"), ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2")])
@pytest.mark.parametrize("suffix", [".yml", ".xml"])
def test_a_stereo_calibration_of_opencv_gives_the_left_and_the_right_camera(
    tmp_path: Path, names: tuple[str, ...], suffix: str
) -> None:
    path = tmp_path / f"stereo{suffix}"
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name in names:
        file.write(name, np.array(BROWN)[None] if name[0] in "Dd" else np.array(K))
    for name, matrix in {"R": R, "T": T[:, None], "E": np.eye(3), "F": np.eye(3), "Q": np.eye(4)}.items():
        file.write(name, matrix)
    file.write("image_width", WIDTH)
    file.write("image_height", HEIGHT)
    file.release()
    cameras = read_calibration(path)
    as_camera(cameras["right"])
    assert (cameras["left"].placement.C, cameras["left"].lens.K) == ([0, 0, 0], K)


def test_the_baseline_of_a_stereo_calibration_is_doubted_until_its_unit_is_stated(tmp_path: Path) -> None:
    stereo: dict[str, object] = {"M1": K, "D1": BROWN, "M2": K, "D2": BROWN, "image_width": WIDTH, "image_height": HEIGHT}
    pose: dict[str, object] = {"R": R.tolist(), "T": [-120.0, 0.0, 0.5]}
    (tmp_path / "site.yaml").write_text(
        "site: s\ncaptures: {root: ., pattern: '{camera}.jpg'}\ncalibration: stereo.yaml\ncameras: [left, right]\n"
    )

    def doubts(content: dict[str, object]) -> list[str]:
        write(tmp_path / "stereo.yaml", content)
        return [str(doubt) for doubt in load_site(tmp_path).doubts]

    (doubt,) = doubts(stereo | pose)
    assert "site.yaml:3:14: calibration: T of a stereo calibration has no unit" in doubt
    assert "120.001 is taken as the metres between the two cameras" in doubt and "unit: m" in doubt
    assert doubts(stereo | pose | {"unit": "m"}) == [] == doubts(stereo)
    with pytest.raises(SiteError, match="unit is mm, and lengths are metres here"):
        doubts(stereo | pose | {"unit": "mm"})


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"camera_matrix": [[240, 5, 0, 160, 2], [0, 240, 5, 90, 1], [0, 0, 1]]}, "3x3 numbers, not 13.*point, not a comma"),
        ({"camera_matrix": [[240.5, 0, 0], [0, 240.5, 0], [160, 90, 1]]}, "this is transposed, as MATLAB writes it"),
    ],
)
def test_a_camera_matrix_in_another_form_is_refused_with_the_reason(
    tmp_path: Path, content: dict[str, object], words: str
) -> None:
    lens = {"distortion_coefficients": BROWN, "image_width": WIDTH, "image_height": HEIGHT}
    with pytest.raises(SiteError) as caught:
        read_calibration(write(tmp_path / "gate.yaml", content | lens))
    assert re.search(words, str(caught.value), re.DOTALL)


def test_the_lens_of_a_depth_camera_is_read(tmp_path: Path) -> None:
    """RealSense writes its model as two words."""
    lens: dict[str, object] = {"width": WIDTH, "height": HEIGHT, "fx": 240.5, "fy": 240.5, "ppx": 160.2, "ppy": 90.1}
    camera = read_calibration(write(tmp_path / "gate.json", lens | {"model": "Brown Conrady", "coeffs": BROWN}))["gate"]
    assert (camera.lens.model, camera.lens.distortion) == ("brown", BROWN)


def test_a_rotation_in_a_ros_message_is_the_rectification_and_no_pose(tmp_path: Path) -> None:
    projection = np.column_stack([K, [-80.0, 0, 0]]).ravel().tolist()
    message = {"header": {"frame_id": "gate"}, "width": WIDTH, "height": HEIGHT, "distortion_model": "plumb_bob", "D": BROWN}
    message |= {"K": np.ravel(K).tolist(), "R": R.ravel().tolist(), "P": projection, "binning_x": 0, "binning_y": 0}
    camera = read_calibration(write(tmp_path / "gate.yaml", message))["gate"]
    assert camera.lens.K == K and camera.placement.R is None
    with pytest.raises(SiteError, match="binning_x above 1"):
        read_calibration(write(tmp_path / "gate.yaml", message | {"binning_x": 2}))


def test_each_kalibr_chain_in_a_folder_is_the_camera_of_its_file(tmp_path: Path) -> None:
    """Kalibr calls the only camera of each file cam0, and adds the topic that it was recorded from."""
    for number, name in enumerate(("cam0", "cam1", "gate")):
        entry = {"camera_model": "pinhole", "intrinsics": [240.5 + number, 240.5, 160.2, 90.1], "resolution": [320, 180]}
        entry |= {"distortion_model": "radtan", "distortion_coeffs": [-0.1, 0.04, 0.0001, 0.0002], "cam_overlaps": []}
        write(tmp_path / f"{name}.yaml", {"cam0": entry | {"rostopic": f"/{name}/image_raw"}})
    cameras = read_calibration(tmp_path)
    assert {name: camera.lens.K[0][0] for name, camera in cameras.items() if camera.lens.K} == {
        "cam0": 240.5,
        "cam1": 241.5,
        "gate": 242.5,
    }
    (tmp_path / "site.yaml").write_text(
        "site: s\ncaptures: {root: ., pattern: '{camera}.jpg'}\ncameras: [{id: roof, calibration: gate.yaml}]\n"
    )
    assert load_site(tmp_path / "site.yaml").cameras[0].lens.K[0][0] == 242.5  # type: ignore[index]


def test_files_of_a_folder_that_name_the_same_cameras_are_refused(tmp_path: Path) -> None:
    for name in ("a.json", "b.json"):
        write(tmp_path / name, {"gate": LENS, "roof": LENS})
    with pytest.raises(SiteError, match=r"b.json: holds a camera 'gate', and so does a.json"):
        read_calibration(tmp_path)


def test_pictures_of_one_name_in_two_folders_are_not_told_apart(tmp_path: Path) -> None:
    cameras = read_calibration(write(tmp_path / "c.json", {"a/1.jpg": LENS, "b/1.jpg": LENS | POSE, "gate/2.jpg": LENS}))
    assert list(find_cameras(cameras, "1")) == ["a/1.jpg", "b/1.jpg"]
    assert list(find_cameras(cameras, "gate")) == ["gate/2.jpg"]
    (tmp_path / "site.yaml").write_text(
        "site: s\ncaptures: {root: ., pattern: '{camera}.jpg'}\ncameras: ['1', gate]\ncalibration: c.json\n"
    )
    with pytest.raises(SiteError, match=r"cameras\[0\]: the calibration has a/1.jpg and b/1.jpg, which may both be '1'"):
        load_site(tmp_path / "site.yaml")


IMAGES = """# Image list
1 1 0 0 0 1 2 3 1 gate.jpg
{points}2 1 0 0 0 4 5 6 1 roof 2.jpg
{points}3 1 0 0 0 7 8 9 1 mast.jpg
{points}"""


@pytest.mark.parametrize(
    "points",
    ["", "\n", "10.5 20.5 -1 30 40 7\n", "10 20 -1 30 40 7 1 2 3 4 5 6\n", "\n\n"],
    ids=["left out", "empty", "two", "four", "twice"],
)
def test_second_lines_of_colmap_images_may_be_left_out(tmp_path: Path, points: str) -> None:
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 640 480 500 510 320 240\n")
    (tmp_path / "images.txt").write_text(IMAGES.format(points=points))
    cameras = read_calibration(tmp_path)
    centres = {name: camera.placement.C for name, camera in cameras.items()}
    assert centres == {"gate.jpg": [-1, -2, -3], "roof 2.jpg": [-4, -5, -6], "mast.jpg": [-7, -8, -9]}
    assert read_calibration(tmp_path / "cameras.txt") == cameras, "one of its files stands for the model"


METASHAPE = """<?xml version="1.0" encoding="UTF-8"?>
<document version="2.0.0">
 <chunk label="Chunk 1" enabled="true">
  <sensors next_id="1">
   <sensor id="0" label="FC330" type="{type}">
    <resolution width="640" height="480"/>
    <property name="pixel_width" value="0.001"/>
    <bands><band label="Red"/></bands>
    <data_type>uint8</data_type>
    <calibration type="{type}" class="initial"><resolution width="640" height="480"/><f>999</f></calibration>
    <calibration type="{type}" class="adjusted">
     <resolution width="640" height="480"/>
     <f>399.1</f><cx>-1.3</cx><cy>4.2</cy><b1>3.4</b1>{coefficients}
    </calibration>
    <covariance><params>f</params><coeffs>1</coeffs></covariance>
   </sensor>
  </sensors>
  <components next_id="1" active_id="0"><component id="0" label="Component 1">{world}</component></components>
  <cameras next_id="2" next_group_id="0">
   <camera id="0" sensor_id="0" component_id="0" label="gate"><transform>{transform}</transform>
    <orientation>1</orientation><reference x="1" y="2" z="3" enabled="1"/></camera>
   <camera id="1" sensor_id="0" label="roof"/>
  </cameras>
  <reference>LOCAL_CS["Local Coordinates (m)",LOCAL_DATUM["Local Datum",0],UNIT["metre",1]]</reference>
 </chunk>
</document>
"""
TANGENTIAL = f"<p1>{BROWN[3]}</p1><p2>{BROWN[2]}</p2>"


def metashape(path: Path, **changed: str) -> Path:
    """An export whose chunk is turned, moved and four times as large as the world."""
    turn = cv2.Rodrigues(np.array([0.2, 0.5, -0.4]))[0]
    offset, scale = np.array([10.0, 20.0, -3.0]), 0.25
    in_chunk = np.eye(4)
    in_chunk[:3, :3], in_chunk[:3, 3] = turn.T @ C2W[:3, :3], turn.T @ (C - offset) / scale
    values = {
        "type": "frame",
        "coefficients": f"<k1>{BROWN[0]}</k1><k2>{BROWN[1]}</k2><k3>{BROWN[4]}</k3>{TANGENTIAL}",
        "transform": " ".join(map(repr, in_chunk.ravel().tolist())),
        "world": f"<transform><rotation locked='false'>{' '.join(map(repr, turn.ravel().tolist()))}</rotation>"
        f"<translation>{' '.join(map(repr, offset.tolist()))}</translation><scale>{scale}</scale></transform>",
    }
    path.write_text(METASHAPE.format(**(values | changed)))
    return path


def test_cameras_of_metashape_are_read(tmp_path: Path) -> None:
    cameras = read_calibration(metashape(tmp_path / "cameras.xml"))
    as_camera(cameras["gate"])
    assert cameras["gate"].placement.metric
    assert cameras["roof"].lens.K == cameras["gate"].lens.K and cameras["roof"].placement.R is None
    coefficients = "".join(f"<k{n}>{value}</k{n}>" for n, value in enumerate(FISHEYE, 1))
    fisheye = read_calibration(metashape(tmp_path / "cameras.xml", type="fisheye", coefficients=coefficients))["gate"]
    assert (fisheye.lens.model, fisheye.lens.distortion) == ("fisheye", FISHEYE)
    assert not read_calibration(metashape(tmp_path / "cameras.xml", world=""))["gate"].placement.metric


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<k1>", "<k4>0.1</k4><k1>", "k4 is 0.1, and this coefficient is not read"),
        ("<k1>", "<wobble>0.1</wobble><k1>", "<wobble> in <calibration> is not read"),
        ("LOCAL_CS", "GEOGCS", "a coordinate system of the Earth"),
        ("<orientation>1", "<orientation>6", "were turned"),
        ("<calibration", "<property name='film_camera' value='true'/><calibration", "is a film camera"),
        ("<calibration", "<film_camera>1</film_camera><calibration", "is a film camera"),
        ('type="frame"', 'type="spherical"', "is a spherical sensor"),
        ("<f>399.1</f>", "<f>far</f>", "cameras.xml:13: <f> must hold 1 numbers"),
        ("<document", "<!DOCTYPE x><document", "declares a document type"),
        ("</chunk>", "", "not valid XML"),
        ("<document", "<nobody", "not valid XML"),
    ],
)
def test_what_cannot_be_read_of_metashape_is_refused_with_its_line(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = metashape(tmp_path / "cameras.xml")
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(SiteError, match=message):
        read_calibration(path)


PIX4D = """fileName imageWidth imageHeight
camera matrix K [3x3]
radial distortion [3x1]
tangential distortion [2x1]
camera position t [3x1]
camera rotation R [3x3]
camera model m = K [R|-Rt] X

"""


def pix4d(*names: str) -> str:
    numbers = [*K, [BROWN[0], BROWN[1], BROWN[4]], BROWN[2:4], C.tolist(), *R.tolist()]
    block = "".join(" ".join(map(repr, row)) + "\n" for row in numbers)
    return PIX4D + "".join(f"{name} {WIDTH} {HEIGHT}\n{block}" for name in names)


def test_calibrated_camera_parameters_of_pix4d_are_read(tmp_path: Path) -> None:
    path = tmp_path / "site_calibrated_camera_parameters.txt"
    path.write_text(pix4d("gate.JPG", "roof 2.JPG"))
    cameras = read_calibration(path)
    assert list(cameras) == ["gate.JPG", "roof 2.JPG"]
    as_camera(cameras["gate.JPG"])
    as_camera(cameras["roof 2.JPG"])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (pix4d("gate.JPG").replace("tangential distortion [2x1]", "tangential distortion [3x1]"), ":4: says .* another layout"),
        (pix4d("gate.JPG", "gate.JPG"), ":19: is not the first line of a picture"),
        (pix4d("gate.JPG")[:-60], ":9: gate.JPG lacks lines|numbers, 3 are expected"),
        (pix4d("gate.JPG").replace("0.0004", "small"), ":14: must hold numbers"),
    ],
)
def test_a_damaged_file_of_pix4d_is_refused_with_its_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "p.txt").write_text(text)
    with pytest.raises(SiteError, match=message):
        read_calibration(tmp_path / "p.txt")


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "c2w of unknown axes": ({"c2w": C2W.tolist()}, "gate.c2w does not say which way the camera's axes point"),
    "transform_matrix": ({"transform_matrix": C2W.tolist()}, "gate.transform_matrix does not say"),
    "extrinsics": ({"extrinsics": W2C.tolist()}, "gate.extrinsics can be understood in more than one way"),
    "rotation": ({"rotation": R.tolist(), "translation": T.tolist()}, "gate.rotation can be understood"),
    "a projection": ({"P": W2C[:3].tolist()}, "gate.P can be understood in more than one way"),
    "no rotation": ({"t": T.tolist()}, "gate.t needs a rotation"),
    "t and C that differ": (POSE | {"C": [0, 0, 0]}, r"gate.t contradicts the centre: -R\^T t is \[3.000, -12.500, 4.250\]"),
    "two poses": (POSE | {"w2c": W2C.tolist()}, "states its pose twice"),
    "R and rvec": ({"R": R.tolist(), "rvec": [0, 0, 1], "t": T.tolist()}, "rvec and R are both given"),
    "K twice": ({"camera_matrix": np.eye(3).tolist()}, "gate.camera_matrix differs from K"),
    "a column-major K": ({"K": np.transpose(K).tolist()}, r"gate.K must be \[\[fx"),
    "distortion twice": ({"dist": [0.1, 0.0, 0.0, 0.0]}, "gate.dist differs from distortion"),
    "a distortion of its own and k1": ({"k1": 0.1}, "gate.distortion and k1 are both given"),
    "an unknown key": ({"skew": 0.1}, "gate.skew is not read"),
    "a misspelt key": ({"positon_sigma_m": 0.1}, "gate.positon_sigma_m is not read.*\n.*did you mean 'position_sigma_m'"),
    "a principal point in c": ({"c": [1, 2]}, "gate.c is not read"),
    "a unit": ({"unit": "mm"}, "gate.unit is mm, and lengths are metres here"),
    "an unknown convention": ({"c2w": C2W.tolist(), "convention": "unity"}, "gate.convention is not known"),
    "a rotation with a scale": ({"w2c": (2 * W2C).tolist()}, "gate.w2c must be 4x4|begin with a rotation"),
    "a vector in degrees": ({"rvec": [0, 0, 90], "t": T.tolist()}, "gate.rvec turns by 90.0 rad, more than a full turn"),
    "a quaternion of either order": ({"quaternion": [1, 0, 0, 0], "t": T.tolist()}, "gate.quaternion can be understood in"),
    "a mirror": ({"R": (-R).tolist(), "t": T.tolist()}, "gate.R is a mirror"),
    "a size of MATLAB": ({"width": None, "height": None, "ImageSize": [480, 640]}, "gate.ImageSize may be MATLAB's"),
}


@pytest.mark.parametrize(("keys", "message"), REFUSED.values(), ids=REFUSED)
def test_what_is_ambiguous_contradictory_or_not_understood_is_refused_by_name(
    tmp_path: Path, keys: dict[str, Any], message: str
) -> None:
    path = write(tmp_path / "cameras.json", {"gate": LENS | keys})
    with pytest.raises(SiteError, match=message) as caught:
        read_calibration(path)
    (problem,) = caught.value.problems
    assert problem.line == 1 and problem.column > 1 and problem.remedy


def test_keys_that_no_reader_asks_for_are_refused_in_every_dialect(tmp_path: Path) -> None:
    kalibr = {"camera_model": "pinhole", "intrinsics": [1, 1, 1, 1], "resolution": [2, 2], "distortion_model": "none"}
    opencv = {"camera_matrix": K, "dist_coeffs": BROWN, "image_width": WIDTH, "image_height": HEIGHT}
    stereo = {"M1": K, "D1": BROWN, "M2": K, "D2": BROWN, "image_width": WIDTH, "image_height": HEIGHT}
    splat = {"img_name": "a", "width": 2, "height": 2, "position": [0, 0, 0], "rotation": np.eye(3).tolist(), "fx": 1, "fy": 1}
    files: list[object] = [{"gate": LENS | {"odd": 1}}, {"cam0": kalibr | {"odd": 1}}, opencv | {"odd": 1}, stereo | {"odd": 1}]
    files += [transforms(NERF_LENS | {"odd": 1}), transforms(NERF_LENS, odd=1), [splat | {"odd": 1}], {"gate": LENS, "odd": 1}]
    files += [[{"name": "gate", **LENS, "odd": 1}], {"odd": 1, "cameras": {"gate": LENS}}, {"cam0": kalibr, "odd": 1}]
    for data in files:
        with pytest.raises(SiteError, match="odd"):
            read_calibration(write(tmp_path / "c.json", data))


def test_a_key_that_stands_twice_in_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text('{"gate": {"K": 1, "K": 2}}')
    with pytest.raises(SiteError, match="the key 'K' is there twice"):
        read_calibration(tmp_path / "c.json")


def test_inner_mappings_of_intrinsics_and_extrinsics_are_read(tmp_path: Path) -> None:
    intrinsics = {"fx": 402.5, "fy": 399.1, "cx": 318.2, "cy": 243.7, "width": WIDTH, "height": HEIGHT}
    entry = {"intrinsics": intrinsics, "distortion": BROWN, "extrinsics": {"R": R.tolist(), "t": T.tolist()}, "units": "m"}
    as_camera(read_calibration(write(tmp_path / "c.json", {"gate": entry}))["gate"])
    for changed in ({"fx": 1}, {"units": "mm"}, {"intrinsics": intrinsics | {"odd": 1}}):
        with pytest.raises(SiteError, match=r"fx, which is given|is mm, and lengths are metres|odd is not read"):
            read_calibration(write(tmp_path / "c.json", {"gate": entry | changed}))


@pytest.mark.parametrize("name", ["gate", "gate-camchain", "camchain-gate", "gate_calibration", "calib_gate"])
def test_one_camera_of_kalibr_without_a_name_has_that_of_its_file(tmp_path: Path, name: str) -> None:
    entry = {"camera_model": "pinhole", "intrinsics": [402.5, 399.1, 318.2, 243.7], "resolution": [WIDTH, HEIGHT]}
    write(tmp_path / f"{name}.yaml", entry | {"distortion_model": "radtan", "distortion_coeffs": BROWN[:4]})
    write(tmp_path / "roof.yaml", {"cam0": entry | {"distortion_model": "none"}})
    (camera,) = find_cameras(read_calibration(tmp_path), "gate").values()
    assert camera.lens.K == K
