"""From two photographs to disparity with the exports of `wbflow_stages`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import wbflow_stages as wb
from tests.helpers.synthetic_site import single_pair, write_straight


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


def test_a_stated_field_of_view_sets_the_focal_length(folder: Path) -> None:
    frame = wb.read_frame(folder / "left.png", hfov_deg=60.0, resolution=480)
    assert frame.image.shape[1] == 480 and frame.view.K is not None
    np.testing.assert_allclose(frame.view.K[0, 0], 240 / np.tan(np.radians(30)), rtol=0.01)


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
