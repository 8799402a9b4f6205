"""The small demo yard for tests: rendered in a few seconds, once per process and set of arguments."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from wbflow_demo.render.photograph import Daytime, DemoCamera, DemoSite, Shots
from wbflow_demo.yard import yard
from wbflow_stages.types import Uint8s


def small_yard(light: Daytime = "day", captures: int = 3, seed: int = 0) -> DemoSite:
    """4 cameras of 320x180."""
    return _rendered(4, 320, captures, seed, light)


def single_pair(width: int = 640) -> DemoSite:
    """Two neighbours, 20 degrees apart, one capture each, at 16:9."""
    return _rendered(2, width, 1, 0, "day")


def straight_capture(camera: DemoCamera) -> Uint8s:
    """A camera's first capture without distortion: no F fits two views through lenses as distorted as the yard's."""
    assert camera.lens.K is not None
    return np.asarray(cv2.undistort(camera.captures[0], camera.lens.K, camera.lens.distortion), dtype=np.uint8)


def write_straight(file: Path, camera: DemoCamera) -> None:
    """Write a camera's first capture without distortion."""
    cv2.imwrite(str(file), cv2.cvtColor(straight_capture(camera), cv2.COLOR_RGB2BGR))


@cache
def _rendered(cameras: int, width: int, captures: int, seed: int, light: Daytime) -> DemoSite:
    return yard(Shots(cameras, captures, (width, width * 9 // 16), seed, light))


@pytest.fixture(scope="session")
def yard_small() -> DemoSite:
    """`small_yard()` as a fixture; import it into a test module to use it."""
    return small_yard()
