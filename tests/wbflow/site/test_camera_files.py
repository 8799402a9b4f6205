"""Calibration files of other programs are read, and give the same rays as in those programs."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest

from wbflow.site.calibration import read_calibration
from wbflow.site.calibration.calibrated import Calibrated
from wbflow.site.load import load_site
from wbflow.site.yaml_document import SiteError
from wbflow_stages.core.lenses import lens_pixels, lens_rays
from wbflow_stages.types import Float64s, Lens

WIDTH, HEIGHT = 640, 480
K = np.array([[402.5, 0.0, 318.2], [0.0, 399.1, 243.7], [0.0, 0.0, 1.0]])
GRID = np.stack(np.meshgrid(np.linspace(0, WIDTH - 1, 14), np.linspace(0, HEIGHT - 1, 11)), axis=-1).reshape(-1, 2)
BROWN = [-0.21, 0.055, 0.0004, -0.0003, -0.008]
RATIONAL = [0.35, 0.11, 0.0004, -0.0003, 0.004, 0.62, 0.18, 0.02]
FISHEYE = [-0.02, 0.005, 0.001, -0.0002]
ALMOST = 1e-9


def rays_of(camera: Calibrated) -> Float64s:
    lens = Lens(
        np.array(camera.lens.K),
        np.array(camera.lens.distortion or [0.0]),
        None,
        camera.lens.width,
        camera.lens.height,
        camera.lens.model,
    )
    rays = lens_rays(lens, GRID)
    assert np.abs(lens_pixels(lens, rays) - GRID).max() < ALMOST, "there and back"
    return rays


def opencv_pixels(rays: Float64s, coefficients: list[float], fisheye: bool = False) -> Float64s:
    """The pixels (n, 2) to which OpenCV projects rays."""
    nothing, points = np.zeros(3), np.ascontiguousarray((rays / rays[:, 2:])[:, None])
    project = cv2.fisheye.projectPoints if fisheye else cv2.projectPoints
    arguments = (points, nothing, nothing, K, np.array(coefficients))
    return np.asarray(project(*arguments)[0].reshape(-1, 2), dtype=np.float64)


def file_storage(path: Path, coefficients: list[float], **more: int) -> Path:
    """Write a calibration as OpenCV's calibration sample does."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in {"image_width": WIDTH, "image_height": HEIGHT, **more}.items():
        file.write(name, value)
    file.write("camera_matrix", K)
    file.write("distortion_coefficients", np.array(coefficients)[:, None])
    file.release()
    return path


@pytest.mark.parametrize("suffix", [".yaml", ".json"])
@pytest.mark.parametrize(("coefficients", "model"), [(BROWN, "brown"), (RATIONAL, "rational"), (FISHEYE, "fisheye")])
def test_calibrations_of_opencv_give_the_pixels_of_opencv(
    tmp_path: Path, suffix: str, coefficients: list[float], model: str
) -> None:
    fisheye = model == "fisheye"
    path = file_storage(tmp_path / f"gate{suffix}", coefficients, **({"fisheye_model": 1} if fisheye else {}))
    camera = read_calibration(path)["gate"]
    assert (camera.lens.model, camera.lens.width, camera.lens.height) == (model, WIDTH, HEIGHT)
    assert np.abs(opencv_pixels(rays_of(camera), coefficients, fisheye) - GRID).max() < ALMOST


@pytest.mark.parametrize("written", ["0.7", "!!opencv-matrix {rows: 1, cols: 1, dt: d, data: [1.2]}"])
def test_omnidir_calibrations_of_opencv_are_read_as_omni_lenses(tmp_path: Path, written: str) -> None:
    path = file_storage(tmp_path / "gate.yaml", BROWN[:4])
    path.write_text(path.read_text() + f"xi: {written}\n")
    camera = read_calibration(path)["gate"]
    assert camera.lens.model == "omni" and camera.lens.distortion is not None
    sphere = rays_of(camera) + np.array([0, 0, camera.lens.distortion[0]])  # Mei's model: a pinhole sees the shifted sphere
    assert np.abs(opencv_pixels(sphere, BROWN[:4]) - GRID).max() < ALMOST


def test_json_with_mtx_and_dist_gives_the_pixels_of_opencv(tmp_path: Path) -> None:
    data = {"mtx": K.tolist(), "dist": [BROWN], "image_size": [WIDTH, HEIGHT]}
    (tmp_path / "gate.json").write_text(json.dumps(data))
    camera = read_calibration(tmp_path / "gate.json")["gate"]
    assert np.abs(opencv_pixels(rays_of(camera), BROWN) - GRID).max() < ALMOST


ROS = """
image_width: {width}
image_height: {height}
camera_name: narrow
camera_matrix: {{rows: 3, cols: 3, data: {K}}}
distortion_model: {model}
distortion_coefficients: {{rows: 1, cols: {count}, data: {D}}}
rectification_matrix: {{rows: 3, cols: 3, data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}}
"""


@pytest.mark.parametrize(
    ("model", "coefficients"), [("plumb_bob", BROWN), ("rational_polynomial", RATIONAL), ("equidistant", FISHEYE)]
)
def test_calibrations_of_ros_give_the_pixels_of_opencv(tmp_path: Path, model: str, coefficients: list[float]) -> None:
    text = ROS.format(width=WIDTH, height=HEIGHT, K=K.ravel().tolist(), model=model, count=len(coefficients), D=coefficients)
    (tmp_path / "ost.yaml").write_text(text)
    camera = read_calibration(tmp_path / "ost.yaml")["narrow"]
    assert np.abs(opencv_pixels(rays_of(camera), coefficients, model == "equidistant") - GRID).max() < ALMOST


ECHO = """
header: {{stamp: {{sec: 1, nanosec: 2}}, frame_id: gate}}
height: 600
width: 800
distortion_model: plumb_bob
d: {D}
k: {K}
binning_x: 0
binning_y: 0
roi: {{x_offset: {x}, y_offset: {y}, height: {height}, width: {width}, do_rectify: false}}
---
"""


@pytest.mark.parametrize("message", ["", "roi reaches beyond"])
def test_an_echoed_ros_message_with_a_region_of_interest_is_read(tmp_path: Path, message: str) -> None:
    whole = np.add(K, [[0, 0, 100], [0, 0, 50], [0, 0, 0]]).ravel().tolist()
    text = ECHO.format(D=BROWN, K=whole, x=200 if message else 100, y=50, width=WIDTH, height=HEIGHT)
    (tmp_path / "gate.yaml").write_text(text)
    if message:
        with pytest.raises(SiteError, match=message):
            read_calibration(tmp_path / "gate.yaml")
        return
    camera = read_calibration(tmp_path / "gate.yaml")["gate"]
    assert (camera.lens.width, camera.lens.height) == (WIDTH, HEIGHT)
    assert np.abs(opencv_pixels(rays_of(camera), BROWN) - GRID).max() < ALMOST, "pixels are counted from the region's corner"


KALIBR = """
cam0:
  camera_model: pinhole
  intrinsics: [402.5, 399.1, 318.2, 243.7]
  distortion_model: radtan
  distortion_coeffs: [-0.21, 0.055, 0.0004, -0.0003]
  resolution: [640, 480]
  rostopic: /gate/image_raw
cam1:
  camera_model: pinhole
  intrinsics: [402.5, 399.1, 318.2, 243.7]
  distortion_model: equidistant
  distortion_coeffs: [-0.02, 0.005, 0.001, -0.0002]
  resolution: [640, 480]
  T_cn_cnm1: [[0, -1, 0, 0.5], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
cam2:
  camera_model: omni
  intrinsics: [0.9, 402.5, 399.1, 318.2, 243.7]
  distortion_model: radtan
  distortion_coeffs: [-0.21, 0.055, 0.0004, -0.0003]
  resolution: [640, 480]
"""


def test_a_camera_chain_of_kalibr_is_read(tmp_path: Path) -> None:
    (tmp_path / "camchain.yaml").write_text(KALIBR)
    cameras = read_calibration(tmp_path / "camchain.yaml")
    assert np.abs(opencv_pixels(rays_of(cameras["cam0"]), BROWN[:4]) - GRID).max() < ALMOST
    assert np.abs(opencv_pixels(rays_of(cameras["cam1"]), FISHEYE, fisheye=True) - GRID).max() < ALMOST
    sphere = rays_of(cameras["cam2"]) + np.array([0, 0, 0.9])  # Mei's model: a pinhole sees the shifted sphere
    assert np.abs(opencv_pixels(sphere, BROWN[:4]) - GRID).max() < ALMOST
    assert cameras["gate/image_raw"] is cameras["cam0"]
    assert cameras["cam1"].placement.C is not None and np.allclose(cameras["cam1"].placement.C, [0, 0.5, 0]), (
        "each camera lies as the chain says"
    )
    assert cameras["cam2"].placement.R is None


def unprojected(model: str, shape: list[float], m: Float64s) -> Float64s:
    """Rays (n, 3) of normalized image points m (n, 2), by the published closed forms; nan where the lens images nothing.

    omni: Mei & Rives, ICRA 2007; eucm: Khomutenko, Garcia & Martinet, RA-L 2016; ds: Usenko, Demmel & Cremers, 3DV 2018.
    """
    r2 = (m**2).sum(axis=1)
    one = np.ones_like(r2)
    with np.errstate(invalid="ignore"):
        if model == "omni":
            (xi,) = shape
            length = (xi + np.sqrt(1 + (1 - xi * xi) * r2)) / (1 + r2)
            return np.column_stack([length[:, None] * m, length - xi])
        if model == "eucm":
            alpha, beta = shape
            z = (1 - beta * alpha**2 * r2) / (alpha * np.sqrt(1 - (2 * alpha - 1) * beta * r2) + (1 - alpha) * one)
            return np.column_stack([m, z])
        xi, alpha = shape
        z = (1 - alpha**2 * r2) / (alpha * np.sqrt(1 - (2 * alpha - 1) * r2) + (1 - alpha) * one)
        length = (z * xi + np.sqrt(z * z + (1 - xi * xi) * r2)) / (z * z + r2)
        return np.column_stack([length[:, None] * m, length * z - xi])


@pytest.mark.parametrize(
    ("model", "shape", "distortion"),
    [
        ("omni", [(0.3, 2.2)], "none"),
        ("omni", [(0.3, 2.2)], "radtan"),
        ("eucm", [(0.05, 0.95), (0.6, 1.6)], "none"),
        ("ds", [(-0.3, 0.3), (0.3, 0.7)], "none"),
    ],
)
def test_random_lenses_of_kalibr_agree_with_the_published_models(
    tmp_path: Path, model: str, shape: list[tuple[float, float]], distortion: str
) -> None:
    rng = np.random.default_rng(len(model) + len(distortion))
    for _ in range(12):
        drawn = [float(rng.uniform(*ends)) for ends in shape]
        coefficients = [float(rng.uniform(-most, most)) for most in (0.1, 0.02, 0.002, 0.002)] if distortion == "radtan" else []
        focal = float(rng.uniform(500, 900))
        entry = {"camera_model": model, "intrinsics": [*drawn, focal, 0.99 * focal, 318.2, 243.7], "resolution": [WIDTH, HEIGHT]}
        entry |= {"distortion_model": distortion, "distortion_coeffs": coefficients}
        (tmp_path / "camchain.yaml").write_text(json.dumps({"cam0": entry}))
        camera = read_calibration(tmp_path / "camchain.yaml")["cam0"]
        m = (GRID - [318.2, 243.7]) / [focal, 0.99 * focal]
        rays = unprojected(model, drawn, m)
        before, nothing = np.column_stack([m, np.ones(len(m))]), np.zeros(3)
        there = cv2.projectPoints(before, nothing, nothing, np.array(camera.lens.K), np.array(coefficients or [0.0] * 4))[0][:, 0]
        lens = Lens(np.array(camera.lens.K), np.array(camera.lens.distortion), None, WIDTH, HEIGHT, camera.lens.model)
        seen = np.isfinite(rays).all(axis=1)
        assert seen.mean() > 0.5
        assert np.abs(lens_pixels(lens, rays[seen]) - there[seen]).max() < ALMOST
        found = lens_rays(lens, np.asarray(there[seen], dtype=np.float64))
        straight = rays[seen] / np.linalg.norm(rays[seen], axis=1, keepdims=True)
        assert np.abs(found / np.linalg.norm(found, axis=1, keepdims=True) - straight).max() < ALMOST


COLMAP = {
    "SIMPLE_PINHOLE": [402.5],
    "PINHOLE": [402.5, 399.1],
    "SIMPLE_RADIAL": [402.5, -0.1],
    "RADIAL": [402.5, -0.1, 0.02],
    "OPENCV": [402.5, 399.1, *BROWN[:4]],
    "FULL_OPENCV": [402.5, 399.1, *RATIONAL],
    "SIMPLE_RADIAL_FISHEYE": [402.5, -0.02],
    "RADIAL_FISHEYE": [402.5, -0.02, 0.005],
    "OPENCV_FISHEYE": [402.5, 399.1, *FISHEYE],
    "SIMPLE_FISHEYE": [402.5],
    "FISHEYE": [402.5, 399.1],
    "FOV": [402.5, 399.1, 0.8],
    "THIN_PRISM_FISHEYE": [402.5, 399.1, -0.02, 0.005, 0.001, -0.002, 0.001, 0.0, 0.001, 0.002],
    "RAD_TAN_THIN_PRISM_FISHEYE": [402.5, 399.1, -0.02, 0.005, 0.001, 0, 0, 0, 0.001, -0.002, 0.001, 0.002, 0.003, -0.001],
    "SIMPLE_DIVISION": [402.5, -0.2],
    "DIVISION": [402.5, 399.1, -0.2],
    "EUCM": [402.5, 399.1, 0.6, 1.1],
    "EQUIRECTANGULAR": [],
}


def params_of(name: str) -> list[float]:
    """The parameters of a camera model in COLMAP's order."""
    words = pycolmap.Camera(model=name, width=1, height=1, params=[]).params_info.split(", ")
    focals, given = sum(word.startswith("f") for word in words), COLMAP[name]
    return [*given[:focals], 318.7, 244.2, *given[focals:]] if given else [WIDTH, HEIGHT]


@pytest.mark.parametrize("name", sorted(pycolmap.CameraModelId.__members__.keys() - {"INVALID"}))
def test_every_camera_model_of_colmap_gives_the_pixels_of_colmap(tmp_path: Path, name: str) -> None:
    params = params_of(name)
    words = " ".join(map(repr, params))
    (tmp_path / "cameras.txt").write_text(f"1 {name} {WIDTH} {HEIGHT} {words}\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 gate.jpg\n\n")
    rays = rays_of(read_calibration(tmp_path)["gate.jpg"])
    theirs = np.asarray(pycolmap.Camera(model=name, width=WIDTH, height=HEIGHT, params=params).img_from_cam(rays))
    assert np.abs(theirs - (GRID + 0.5)).max() < ALMOST, "COLMAP's origin is the corner of the first pixel"


DRAWN = {name: [(c - 0.1 * abs(c), c + 0.1 * abs(c)) for c in given if abs(c) < 10] for name, given in COLMAP.items()} | {
    "SIMPLE_RADIAL": [(-0.25, 0.25)],
    "SIMPLE_DIVISION": [(-0.3, 0.05)],
    "DIVISION": [(-0.3, 0.05)],
    "FOV": [(0.2, 1.2)],
    "EUCM": [(0.05, 0.95), (0.6, 1.6)],
    "OPENCV_FISHEYE": [(-0.06, 0.06), (-0.02, 0.02), (-0.005, 0.005), (-0.001, 0.001)],
}
"""Ranges from which the distortion coefficients are drawn, by COLMAP camera model."""


@pytest.mark.parametrize("name", sorted(COLMAP.keys() - {"EQUIRECTANGULAR"}))
def test_random_lenses_of_colmap_give_the_pixels_of_colmap(tmp_path: Path, name: str) -> None:
    rng = np.random.default_rng(len(name))
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 0 1 gate.jpg\n\n")
    focals = len(COLMAP[name]) - len(DRAWN[name])
    for _ in range(4):
        middle = [318.7 + rng.uniform(-20, 20), 244.2 + rng.uniform(-20, 20)]
        focal = rng.uniform(150, 700) * rng.uniform(0.98, 1.02, focals)
        params = [*focal, *middle, *(rng.uniform(*ends) for ends in DRAWN[name])]
        (tmp_path / "cameras.txt").write_text(f"1 {name} {WIDTH} {HEIGHT} {' '.join(map(repr, map(float, params)))}\n")
        camera = read_calibration(tmp_path)["gate.jpg"]
        lens = Lens(np.array(camera.lens.K), np.array(camera.lens.distortion or [0.0]), None, WIDTH, HEIGHT, camera.lens.model)
        theirs = pycolmap.Camera(model=name, width=WIDTH, height=HEIGHT, params=params)
        rays = lens_rays(lens, GRID)
        there = np.asarray(theirs.img_from_cam(rays)) - 0.5
        both = np.isfinite(there).all(axis=1)  # nan behind the camera, and beyond the angle where a model folds over
        assert both.mean() > 0.5
        assert np.abs(there - GRID)[both].max() < ALMOST


@pytest.mark.parametrize(("count", "fisheye"), [(4, True), (4, False), (5, False), (8, False), (12, False), (14, False)])
def test_random_lenses_of_opencv_give_the_pixels_of_opencv(tmp_path: Path, count: int, fisheye: bool) -> None:
    rng = np.random.default_rng(count)
    spread = [0.06, 0.02, 0.005, 0.001] if fisheye else [0.25, 0.05, 0.002, 0.002, 0.01, 0.25, 0.05, 0.01, *[0.003] * 4, 0.03]
    for _ in range(4):
        drawn = [float(rng.uniform(-most, most)) for most in (spread if fisheye else [*spread, 0.03])[:count]]
        path = file_storage(tmp_path / "gate.yaml", drawn, **({"fisheye_model": 1} if fisheye else {}))
        camera = read_calibration(path)["gate"]
        lens = Lens(np.array(camera.lens.K), np.array(camera.lens.distortion), None, WIDTH, HEIGHT, camera.lens.model)
        rays = lens_rays(lens, GRID)
        seen = np.isfinite(rays).all(axis=1) & (rays[:, 2] > 0)
        assert seen.mean() > 0.5
        assert np.abs(opencv_pixels(rays[seen], drawn, fisheye) - GRID[seen]).max() < ALMOST


@pytest.fixture(scope="module")
def binary(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A binary model written by COLMAP, with a camera and an image for every camera model of COLMAP."""
    written = pycolmap.Reconstruction()
    for number, name in enumerate(COLMAP, 1):
        camera = pycolmap.Camera(camera_id=number, model=name, width=WIDTH, height=HEIGHT, params=params_of(name))
        written.add_camera_with_trivial_rig(camera)
        image = pycolmap.Image(image_id=number, camera_id=number, name=f"gäte/{name}.jpg")
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D([k, 2.0]) for k in range(number % 3)])
        turn = np.array([0.1, -0.4, 0.2, 0.3 + number])
        written.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(turn), [number, 2, 3]))
    folder = tmp_path_factory.mktemp("model")
    written.write_binary(str(folder))
    return folder


def test_a_binary_colmap_model_is_read_as_its_text_model(tmp_path: Path, binary: Path) -> None:
    pycolmap.Reconstruction(str(binary)).write_text(str(tmp_path))
    text, found = read_calibration(tmp_path), read_calibration(binary)
    assert len(found) == len(COLMAP) == len(pycolmap.CameraModelId.__members__) - 1
    assert found.keys() == text.keys()
    for name in COLMAP:
        there, here = text[f"gäte/{name}.jpg"], found[f"gäte/{name}.jpg"]
        assert (here.lens.model, here.lens.width, here.lens.height) == (there.lens.model, WIDTH, HEIGHT)
        assert (here.lens.K, here.lens.distortion) == (there.lens.K, there.lens.distortion), "COLMAP writes text with all digits"
        assert (
            here.placement.R is not None
            and here.placement.C is not None
            and there.placement.R is not None
            and there.placement.C is not None
        )
        assert (
            np.abs(np.subtract(here.placement.R, there.placement.R)).max() < ALMOST
            and np.abs(np.subtract(here.placement.C, there.placement.C)).max() < ALMOST
        )


@pytest.mark.parametrize(
    ("name", "spoilt", "message"),
    [
        ("cameras.bin", lambda data: data[:100], "cameras.bin: ends too early"),
        ("cameras.bin", lambda data: data[:12] + b"\x63" + data[13:], "camera model number 99 is not supported"),
        ("cameras.bin", lambda data: data[:32] + b"\0" * 8 + data[40:], "camera 1: a focal length must be positive"),
        ("images.bin", lambda data: data[:-30], "images.bin: ends too early"),
        ("images.bin", lambda data: b"\xff" * 8 + data[8:], "images.bin: ends too early"),
        ("images.bin", lambda data: data[:68] + b"\x63" + data[69:], "image 1 is of camera 99, which cameras.bin lacks"),
        ("images.bin", lambda data: data[:12] + b"\0" * 32 + data[44:], "image 1: its quaternion is zero"),
    ],
)
def test_a_damaged_binary_colmap_model_is_refused_with_a_message(
    tmp_path: Path, binary: Path, name: str, spoilt: Callable[[bytes], bytes], message: str
) -> None:
    for file in ("cameras.bin", "images.bin"):
        data = (binary / file).read_bytes()
        (tmp_path / file).write_bytes(spoilt(data) if file == name else data)
    with pytest.raises(SiteError, match=message):
        read_calibration(tmp_path)


def test_opencv_lenses_with_thin_prism_and_tilted_sensor_are_supported(tmp_path: Path) -> None:
    coefficients = [*RATIONAL, 0.001, 0.002, 0.003, -0.001, 0.03, -0.02]
    camera = read_calibration(file_storage(tmp_path / "gate.yaml", coefficients))["gate"]
    assert np.abs(opencv_pixels(rays_of(camera), coefficients) - GRID).max() < ALMOST


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (("image_width: 640\n", ""), r"gate.yaml:2:1: lacks the size of the pictures"),
        (("plumb_bob", "equidistant"), r"gate.yaml:7:\d+: .*a fisheye lens has 1 or 2 or 3 or 4 coefficients"),
        (("plumb_bob", "wobbly"), "'wobbly' is not a known lens model"),
        (("rows: 3, cols: 3, data: [402.5", "rows: 3, cols: 4, data: [402.5"), "camera_matrix says 3 x 4, and holds 9"),
        (("data: [402.5", "data: [no"), "camera_matrix must hold numbers"),
        (("camera_matrix", "matrix"), "holds no calibration"),
    ],
)
def test_a_faulty_calibration_file_is_refused_with_its_place(tmp_path: Path, changed: tuple[str, str], message: str) -> None:
    text = ROS.format(width=WIDTH, height=HEIGHT, K=K.ravel().tolist(), model="plumb_bob", count=5, D=BROWN)
    (tmp_path / "gate.yaml").write_text(text.replace(*changed))
    with pytest.raises(SiteError) as error:
        read_calibration(tmp_path / "gate.yaml")
    (problem,) = error.value.problems
    assert re.search(message, f"{problem.mark}: {problem.what}")


def test_a_site_reads_calibrations_from_single_files_or_a_folder(tmp_path: Path) -> None:
    (tmp_path / "lenses").mkdir()
    file_storage(tmp_path / "lenses" / "gate.yaml", FISHEYE, fisheye_model=1)
    file_storage(tmp_path / "lenses" / "roof.yaml", BROWN)
    head = "site: harbour\ncaptures: {root: ., pattern: '{camera}.jpg'}\n"
    (tmp_path / "folder.yaml").write_text(head + "cameras: [gate, roof]\ncalibration: lenses\n")
    cameras = "cameras: [{id: front, calibration: lenses/gate.yaml}, {id: back, calibration: lenses/roof.yaml}]\n"
    (tmp_path / "files.yaml").write_text(head + cameras)
    for name in ("folder.yaml", "files.yaml"):
        site = load_site(tmp_path / name)
        assert [c.lens.model for c in site.cameras] == ["fisheye", "brown"]
        assert [c.lens.distortion for c in site.cameras] == [FISHEYE, BROWN]
