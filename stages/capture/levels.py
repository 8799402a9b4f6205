"""Pictures of more than 8 bits as grey levels: which of their values is black, and which is white.

Machine-vision cameras store 10, 12 or 14 bits in values of 16, thermal ones temperatures.  A picture's own darkest and brightest
values are no levels: they change from night to night with what stands in the scene, and so would the brightness of the frames.
The levels here are taken from a few fixed ranges, so that a camera has the same ones every night.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..types import Uint8s

Values = NDArray[Any]
"""(h, w) or (h, w, 3) values of a decoded picture, of any numeric dtype."""

_BITS = (10, 12, 14, 16, 24, 32)
"""Depths of cameras.  8 is missing: values below 256 of 65,536 are a dark picture, which brightening would hide."""
_WIDTHS_K = (20.0, 40.0, 80.0, 160.0)
"""Ranges of temperature that become black to white, kelvins: one is taken that is twice as wide as what the camera sees."""
_MOST_COLD_C = -80.0
"""Values below this, in the units of a thermal camera, are no temperatures; a clear sky measures below -50."""
_MOST_WARM_C = 180.0
"""Values above this, in the units of a thermal camera, are no temperatures of a scene."""
_USUAL_SPREAD_K = 130.0
"""Widest range of temperatures in a scene, kelvins: wider ones are values of another kind."""
_ZERO_C_IN_KELVIN = 273.15
_TAIL = 0.01
"""Share of the values at each end that may be defective pixels, a lamp, or a strip of sky."""
_NARROW = 1.0 / 16.0
"""Values that span less than this share of their depth, and lie far from 0, are raw counts of a thermal sensor."""


@dataclass(frozen=True)
class Levels:
    """The values that become black and white; everything between them is linear."""

    black: float
    white: float
    what: str = ""
    """What was found, in words for the operator."""

    def words(self) -> str:
        """A note for the operator, with what to write to have the same levels whatever the pictures hold."""
        fixed = f"stages: {{frames: {{levels: [{self.black:g}, {self.white:g}]}}}}"
        return f"{self.what}: values from {self.black:g} (black) to {self.white:g} (white); to set them: {fixed}"


EIGHT_BITS = Levels(0.0, 255.0)


def grey_levels_of(values: Values, levels: Levels) -> Uint8s:
    """A picture's values as (h, w) or (h, w, 3) uint8, cut off at black and white; values that are no numbers become black."""
    if values.dtype == np.uint8:
        return np.asarray(values, np.uint8)
    if _is_depth(levels):
        # n bits are divided by 2^(n - 8) and rounded down: 16 bits become the upper byte, as in every other program
        scaled = values.astype(np.float64) * (256 / (levels.white + 1))
    else:
        scaled = (values.astype(np.float64) - levels.black) * (255 / (levels.white - levels.black)) + 0.5
    return np.floor(np.clip(np.nan_to_num(scaled, nan=0.0), 0.0, 255.0)).astype(np.uint8)


def _is_depth(levels: Levels) -> bool:
    return levels.black == 0 and levels.white in {2.0**bits - 1 for bits in _BITS}


def levels_of(pictures: Iterable[Values], stated_white: int | None = None) -> Levels:
    """The levels of a camera's pictures of one night.

    Parameters
    ----------
    pictures : the decoded values of its captures.
    stated_white : the value of white by the files' headers; None: they do not state it.
    """
    lows: list[float] = []
    highs: list[float] = []
    largest = 0.0
    steps = 0
    is_whole = True
    for values in pictures:
        if values.dtype == np.uint8:
            continue
        finite = values[np.isfinite(values)]
        if not finite.size:
            continue
        low, high = np.quantile(finite, [_TAIL, 1 - _TAIL])
        lows.append(float(low))
        highs.append(float(high))
        largest = max(largest, float(finite.max()))
        is_whole = is_whole and np.issubdtype(values.dtype, np.integer)
        if is_whole:
            steps |= int(np.bitwise_or.reduce(finite.astype(np.int64)))
    if not lows:
        return EIGHT_BITS
    low = float(np.median(lows))
    high = float(np.median(highs))
    thermal = _thermal(low, high, is_whole)
    if thermal is not None:
        return thermal
    # many programs state the largest value that the format holds, whatever the camera delivers
    if stated_white is not None and largest <= stated_white < 65535:
        return Levels(0.0, float(stated_white), f"white is {stated_white} by the files' header")
    if not is_whole:
        return _of_fractions(low, largest)
    if steps % 4 == 0:  # the lowest bits are never used: 12 or 14 bits are stored as the upper ones of 16
        return Levels(0.0, 65535.0, "the upper bits of 16 are used")
    bits = next((bits for bits in _BITS if largest < 2.0**bits), _BITS[-1])
    depth = 2.0**bits
    if high - low < _NARROW * depth and low > 0.25 * depth:
        return _window(low, high)
    return Levels(0.0, depth - 1, f"{bits} bits are used")


def _thermal(low: float, high: float, is_whole: bool) -> Levels | None:
    """Levels of temperatures; None if the values are none.  low, high: nearly all values lie between them."""
    units = [("hundredths of a kelvin", 100.0, _ZERO_C_IN_KELVIN), ("tenths of a kelvin", 10.0, _ZERO_C_IN_KELVIN)]
    if not is_whole:
        units = [("kelvins", 1.0, _ZERO_C_IN_KELVIN), ("degrees Celsius", 1.0, 0.0)]
    for name, scale, zero in units:
        coldest = low / scale - zero
        warmest = high / scale - zero
        # a scene spans less than all that a camera measures; fractions from 0 to 1 are no temperatures
        width = next((width for width in _WIDTHS_K if width >= 2 * (warmest - coldest)), _WIDTHS_K[-1])
        is_possible = coldest > _MOST_COLD_C and warmest < _MOST_WARM_C
        is_scene = 1.0 / scale < warmest - coldest < _USUAL_SPREAD_K
        if is_possible and is_scene:
            # on a grid of half its width, the range stays where it is while the weather changes by a few degrees
            black_c = width / 2 * round((coldest + warmest) / width - 1)
            white_c = black_c + width
            what = f"thermal, {name}: {black_c:g} to {white_c:g} degrees Celsius"
            return Levels(scale * (black_c + zero), scale * (white_c + zero), what)
    return None


def _of_fractions(low: float, largest: float) -> Levels:
    """Levels of numbers with fractions that are no temperatures."""
    for white in (1.0, 255.0, *(2.0**bits - 1 for bits in _BITS)):
        if largest <= white and low >= 0:
            return Levels(0.0, white, "numbers with fractions")
    return _window(low, largest)


def _window(low: float, high: float) -> Levels:
    """A range around values far from 0 that stays the same while they drift: a power of two wide, on a grid of half its width."""
    width = 2.0 ** np.ceil(np.log2(max(2 * (high - low), 1e-6)))
    while True:
        black = np.floor(low / (width / 2)) * width / 2
        if high <= black + width:
            return Levels(float(black), float(black + width), "a narrow range far from 0 is used")
        width *= 2
