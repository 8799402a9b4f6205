"""From two photographs to disparity with the exports of `wbflow_stages`."""

from __future__ import annotations

import pickle
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import wbflow_stages as wb
from tests.helpers.synthetic_site import single_pair, straight_capture, write_straight
from wbflow.cache.artifact import encode
from wbflow_stages.types.checking import fault_in


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two photographs of the demo yard, taken with lenses without distortion."""
    folder = tmp_path_factory.mktemp("photographs")
    for name, camera in zip(("left", "right"), single_pair().cameras, strict=True):
        write_straight(folder / f"{name}.png", camera)
    return folder


def test_two_photographs_become_disparity_with_a_few_calls(folder: Path) -> None:
    left, right = wb.read_frame(folder / "left.png"), wb.read_frame(folder / "right.png")
    features = wb.usable(wb.detect(left)), wb.usable(wb.detect(right))
    matches = wb.usable(wb.match(*features))
    geometry = wb.usable(wb.estimate_geometry(matches, *features))
    rectification = wb.usable(wb.rectify(geometry))
    disparity = wb.usable(wb.match_dense(left, right, rectification, matcher="sgbm"))
    d = wb.disparity_px(disparity, 1)
    assert np.isfinite(d).mean() > 0.2 and disparity.density > 0.3
    for result in (left, *features, matches, geometry, rectification, disparity):
        assert len(repr(result)) < 2000
        assert fault_in(result) == "", "what a user's function would have to return"


def test_a_stated_field_of_view_sets_the_focal_length(folder: Path) -> None:
    frame = wb.read_frame(folder / "left.png", hfov_deg=60.0, resolution=480)
    assert frame.image.shape[1] == 480 and frame.view.K is not None
    np.testing.assert_allclose(frame.view.K[0, 0], 240 / np.tan(np.radians(30)), rtol=0.01)


def test_going_on_with_a_rejected_result_says_why_there_is_none() -> None:
    fog = np.broadcast_to(np.linspace(60, 200, 160).astype(np.uint8)[None, :, None], (90, 160, 3)).copy()
    rejected = wb.detect(wb.types.Frame.from_image(fog, K=np.array([[100.0, 0, 79.5], [0, 100, 44.5], [0, 0, 1]])))
    assert isinstance(rejected, wb.Rejected)
    with pytest.raises(ValueError, match=re.escape(rejected.reason)):
        wb.match(rejected, rejected)  # type: ignore[arg-type]
    assert not hasattr(rejected, "xy")
    assert pickle.loads(pickle.dumps(rejected)) == rejected


def test_an_argument_of_a_wrong_type_is_named_with_what_gives_the_right_one(folder: Path) -> None:
    frame = wb.read_frame(folder / "left.png", resolution=320)
    features = wb.usable(wb.detect(frame))
    with pytest.raises(ValueError, match=r"frame is a str; Frame is needed: read_frame\(PATH\)"):
        wb.detect(str(folder / "left.png"))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"left is a Frame; Features is needed: detect\(frame\) gives one"):
        wb.match(frame, features)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"matches is a Features; Matches is needed: match\(left, right\) gives one"):
        wb.estimate_geometry(features, features, features)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="geometry is a Features; Geometry or None is needed"):
        wb.rectify(features)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="rectification is a str; Rectification is needed"):
        wb.match_dense(frame, frame, "rows")  # type: ignore[arg-type]


def test_stages_are_functions_even_after_importing_their_modules() -> None:
    code = (
        "import wbflow_stages as wb, sys\n"
        "assert 'numpy' not in sys.modules and 'cv2' not in sys.modules, 'the package loads heavy libraries'\n"
        "assert wb.types.Frame.__name__ == 'Frame' and 'cv2' not in sys.modules\n"
        "import wbflow_stages.rectify\nfrom wbflow_stages.fuse import fuse\n"
        "assert callable(wb.rectify) and wb.fuse is fuse and callable(wb.refine)\n"
        "import wbflow_stages.refine\nassert callable(wb.refine) and 'match' in dir(wb)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_an_unknown_name_of_the_package_raises_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'mtach'"):
        _ = wb.mtach


def test_a_rejected_result_that_is_needed_raises_its_reason() -> None:
    assert wb.usable("a result") == "a result"
    with pytest.raises(ValueError, match="12 matches, 20 are needed"):
        wb.usable(wb.Rejected("12 matches, 20 are needed"))


def test_a_picture_in_memory_gives_the_frame_of_its_file(folder: Path) -> None:
    camera = single_pair().cameras[0]
    K = np.asarray(camera.lens.K)
    coefficients = np.array([0.1, 0.02])
    image = straight_capture(camera)
    from_memory = wb.types.Frame.from_image(image, K=K, distortion=coefficients, resolution=480)
    from_file = wb.read_frame(folder / "left.png", K=K, distortion=coefficients, resolution=480)
    assert encode(from_memory) == encode(from_file)
    assert from_memory.image.shape[1] == 480 and not from_memory.mask.all(), "the lens does not show its corners"


def test_masked_pixels_of_a_picture_in_memory_are_not_used() -> None:
    image = straight_capture(single_pair().cameras[0])
    mask = np.ones(image.shape[:2], np.bool_)
    mask[:, :100] = False
    frame = wb.types.Frame.from_image(image, mask=mask)
    assert not frame.mask[:, :100].any() and frame.mask[:, 101:].all()
    assert wb.usable(wb.detect(frame)).xy[:, 0].min() > 90


IMAGE = np.full((40, 60, 3), 128, np.uint8)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"image": [[1, 2]]}, "image is a list; an array, uint8 (h, w, 3), is needed"),
        ({"image": IMAGE / 255}, "use (image * 255).round().astype(np.uint8)"),
        ({"image": IMAGE * 1.0}, "use image.round().astype(np.uint8)"),
        ({"image": IMAGE.astype(np.uint16)}, "image is uint16 (40, 60, 3); uint8 (h, w, 3) is needed"),
        ({"image": IMAGE[..., 0]}, "if it is grey, use np.dstack([image] * 3)"),
        ({"image": np.dstack([IMAGE, IMAGE])[..., :4]}, "use image[..., :3]"),
        ({"image": IMAGE[:0]}, "image is empty, (0, 60, 3)"),
        ({"mask": IMAGE[..., 0]}, "mask is uint8 (40, 60); bool (h, w) is needed"),
        ({"mask": np.ones((60, 40), np.bool_)}, "mask is bool (60, 40); bool (h, w) is needed, with h = 40"),
        ({"K": np.eye(2)}, "K is [[1.0, 0.0], [0.0, 1.0]]; [[fx, s, cx], [0, fy, cy], [0, 0, 1]] in pixels is needed"),
        ({"K": [500, 500, "middle"]}, "K is a list that is no array of numbers"),
        ({"K": np.eye(3) * np.nan}, "K has values that are not finite"),
        ({"distortion": np.zeros(6)}, "distortion is (6,); (n,) is needed, n one of 0, 1, 2, 3, 4, 5, 8, 12, 14"),
        ({"hfov_deg": 300}, "hfov_deg is 300; a horizontal field of view between 0 and 180 degrees is needed"),
    ],
)
def test_what_is_no_picture_or_lens_is_refused_with_what_is_needed(arguments: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=re.escape(words)):
        wb.types.Frame.from_image(**{"image": IMAGE, **arguments})
