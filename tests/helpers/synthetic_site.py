"""The small demo yard for tests: rendered once for each set of arguments and process, in a few seconds."""

from __future__ import annotations

from functools import cache

import pytest

from wbflow_stages.synthetic.shooting import Daytime, DemoSite
from wbflow_stages.synthetic.yard import yard


def small_yard(light: Daytime = "day", captures: int = 3, seed: int = 0) -> DemoSite:
    """4 cameras of 320x180."""
    return _rendered(4, 320, captures, seed, light)


def single_pair(width: int = 640) -> DemoSite:
    """Two neighbours, 20 degrees apart, one capture each, at 16:9."""
    return _rendered(2, width, 1, 0, "day")


@cache
def _rendered(cameras: int, width: int, captures: int, seed: int, light: Daytime) -> DemoSite:
    return yard(cameras, (width, width * 9 // 16), captures, seed, light)


@pytest.fixture(scope="session")
def yard_small() -> DemoSite:
    """`small_yard()` as a fixture; import it into a test module to use it."""
    return small_yard()
