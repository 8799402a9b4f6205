"""The small demo yard for tests: rendered once for each set of arguments and process, in a few seconds."""

from __future__ import annotations

from functools import cache

import pytest

from wbflow_stages.synthetic.yard import Daytime, Yard, yard


@cache
def small_yard(light: Daytime = "day", captures: int = 3, seed: int = 0) -> Yard:
    """4 cameras of 320x180."""
    return yard(4, (320, 180), captures, seed, light)


@cache
def single_pair(width: int = 640) -> Yard:
    """Two neighbours, 20 degrees apart, one capture each, at 16:9."""
    return yard(2, (width, width * 9 // 16), 1)


@pytest.fixture(scope="session")
def yard_small() -> Yard:
    """`small_yard()` as a fixture; import it into a test module to use it."""
    return small_yard()
