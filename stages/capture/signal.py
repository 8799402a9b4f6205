"""What a camera's electronics and coding do to a picture: combed rows, blocks, a colour cast, no colour, noise.

Interlaced cameras read every second row a moment later, and a poor line shifts these rows as a whole; recorders that are short of
disk code blocks of 8 x 8 pixels so coarsely that their edges are stronger than what the scene shows.

Noise is measured where it is white, in the captures as they come from the camera: undistorting a picture mixes neighbouring
pixels, after which noise of eleven grey levels reads as two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..core.luminance import block_means, grey_levels, noise_level
from ..types import Float32s, Uint8s

_TILE_PX = 16
_STRUCTURED = 3.0
"""Grey levels by which neighbouring pixels of a row differ, on average, in a tile that can tell of combing."""
_COMBED = 1.3
"""In a combed tile neighbouring rows differ so many times more than every second one."""
_MOST_COMBED = 0.1
"""Share of combed tiles from which on one field only is used."""
_LEAST_PX, _FARTHEST_PX = 0.3, 6.0
"""So far every second row must, and may, lie off as a whole; in pictures that are not combed it is under .03."""
_SHIFTED = 0.8
"""Neighbouring rows differ so many times less, at most, once they are shifted back."""
_MIDDLE_PX = 1024
"""Side of the part of a picture that is looked at."""
_BLOCK_PX = 8
_BLOCKY = 1.5
"""Differences across the borders of blocks are so many times those within, where coding hides the scene."""
_CAST = 1.7
"""The strongest colour over the weakest, mean of the picture: more is no scene under a usual lamp."""
_COLOURLESS = 0.05
"""Saturation, once a cast is taken off, of a picture without colours."""


@dataclass(frozen=True)
class Signal:
    """Figures of one picture, or the median of several: those of `Frame`."""

    combing: float = 0.0
    blocking: float = 1.0
    cast: float = 1.0
    colour: float = 1.0
    noise: float = 0.0

    @classmethod
    def median(cls, several: Sequence[Signal]) -> Signal:
        """Of several pictures."""
        return cls(*(float(np.median([getattr(one, name) for one in several])) for name in cls.__dataclass_fields__))

    def words(self) -> list[str]:
        """What people should know."""
        found = []
        if self.blocking > _BLOCKY:
            found.append(
                f"coded coarsely: blocks of 8 pixels stand out {self.blocking:.1f}-fold; have it recorded at a higher quality"
            )
        if self.colour < _COLOURLESS:
            found.append("without colour: infrared light, or a grey camera")
        elif self.cast > _CAST:
            found.append(f"a cast of colour: one is {self.cast:.1f} times another; look at its white balance")
        return found


def signal_of(image: Uint8s) -> Signal:
    """Figures of a picture (h, w, 3) as it comes from the camera."""
    image = _middle(image)
    grey = np.asarray(grey_levels(image), np.float32)
    means = np.maximum(np.array(cv2.mean(image)[:3]), 1.0)
    balanced = image[::4, ::4].astype(np.float32) * (means.mean() / means).astype(np.float32)
    high, low = balanced.max(axis=2), balanced.min(axis=2)
    saturation = float(np.median((high - low) / np.maximum(high, 1.0)))
    return Signal(_combing(grey), _blocking(grey), float(means.max() / means.min()), saturation, capture_noise(grey))


def _middle(image: Uint8s) -> Uint8s:
    """The middle of a picture; its rows keep their field."""
    top, left = ((side - _MIDDLE_PX) // 2 // 2 * 2 if side > _MIDDLE_PX else 0 for side in image.shape[:2])
    return image[top : top + _MIDDLE_PX, left : left + _MIDDLE_PX]


def _combing(grey: Float32s) -> float:
    """Share of the tiles that have structure along their rows in which neighbouring rows (h, w) differ more than every second."""
    near, far, along = (np.abs(grey[2:] - grey[1:-1]), np.abs(grey[2:] - grey[:-2]), np.abs(np.diff(grey, axis=1))[2:])
    near_tiles, far_tiles, along_tiles = (block_means(each, _TILE_PX) for each in (near[:, 1:], far[:, 1:], along))
    structured = along_tiles > _STRUCTURED
    if structured.sum() < 8:
        return 0.0
    return float((near_tiles > _COMBED * far_tiles)[structured].mean())


def _blocking(grey: Float32s) -> float:
    """Over both directions; which pixel blocks begin at is looked for, since pictures are turned and cut."""
    found = []
    for steps in (np.abs(np.diff(grey, axis=1)).mean(axis=0), np.abs(np.diff(grey, axis=0)).mean(axis=1)):
        count = len(steps) // _BLOCK_PX * _BLOCK_PX
        if count < 4 * _BLOCK_PX:
            return 1.0
        phases = steps[:count].reshape(-1, _BLOCK_PX).mean(axis=0)
        found.append(float(phases.max() / max(np.median(phases), 0.1)))
    return min(found)


def put_right(image: Uint8s) -> tuple[Uint8s, str]:
    """The picture (h, w, 3) without combing, and in words what was done; as it is, and "", where it is not combed.

    Rows of the second field that lie off as a whole are shifted back; else they are made from their neighbours of the first.
    """
    grey = np.asarray(grey_levels(_middle(image)), np.float32)
    shift = _field_shift(grey)
    if _LEAST_PX < abs(shift) <= _FARTHEST_PX:
        shifted = image.copy()
        shifted[1::2] = _shifted(image[1::2], shift)
        now = np.asarray(grey_levels(_middle(shifted)), np.float32)
        if _combing(now) < 0.5 * _MOST_COMBED and _across_rows(now) < _SHIFTED * _across_rows(grey):
            return shifted, "every second row lies off, and is shifted back"
    if _combing(grey) < _MOST_COMBED:
        return image, ""
    first = image[::2]
    below = np.concatenate([first[1:], first[-1:]])[: len(image) // 2]
    single = image.copy()
    single[1::2] = cv2.addWeighted(first[: len(below)], 0.5, below, 0.5, 0)
    return single, "every second row is from another moment (interlaced), and is not used"


def _across_rows(grey: Float32s) -> float:
    return float(np.abs(np.diff(grey, axis=0)).mean())


def _field_shift(grey: Float32s) -> float:
    """By how much every second row lies to the right of what its neighbours say, pixels (Lucas and Kanade, 1981)."""
    first, second = grey[::2], grey[1::2]
    if min(grey.shape) < 32:
        return 0.0
    rows = min(len(first) - 1, len(second))
    between, there = 0.5 * (first[:rows] + first[1 : rows + 1]), second[:rows]
    starts = np.arange(-_FARTHEST_PX, _FARTHEST_PX + 1)  # steps of a pixel; what lies between is found from there
    off = [np.abs(np.roll(between, int(start), axis=1) - there)[:, 8:-8].mean() for start in starts]
    best = float(starts[np.argmin(off)])
    moved = np.roll(between, int(best), axis=1)
    slope = 0.5 * (np.roll(moved, -1, axis=1) - np.roll(moved, 1, axis=1))
    inner = (slice(None), slice(8, -8))
    return best - float((slope * (there - moved))[inner].sum() / max((slope * slope)[inner].sum(), 1e-6))


def _shifted(rows: Uint8s, shift: float) -> Uint8s:
    """(h, w, 3) rows moved to the left by a shift."""
    x, y = np.meshgrid(np.arange(rows.shape[1], dtype=np.float32) + np.float32(shift), np.arange(len(rows), dtype=np.float32))
    return np.asarray(cv2.remap(rows, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.uint8)


NOISY = 2.0
"""Grey levels of noise (standard deviation) of a frame from which on it is denoised."""
_DARKEST, _BRIGHTEST = 12.0, 243.0
"""Mean grey of the surroundings that can tell of noise: what is clipped has none."""
_SURROUNDINGS_PX = 16
_MIXED = 0.67
"""What bilinear interpolation leaves of white noise: 2/3 of its standard deviation, mean over all fractions."""
_PATCH_PX, _SEARCH_PX = 7, 21
_KEPT = 0.35
"""This share of the noise stays.  Even surfaces would else show nothing but what denoising has made of it, alike in all views by
chance: of a study without light 61 % of the points were within 5 cm, 77 % now, and more of them; .2 gives 71 %, .5 76 %."""
_COLOUR_PX = 2.0
"""Colours are smoothed by a Gaussian of so many pixels: they tell little of shape, and their noise is coarse."""


def capture_noise(grey: Float32s) -> float:
    """Standard deviation of the noise of a capture (h, w) as it comes from the camera, grey levels."""
    mean = cv2.blur(grey, (_SURROUNDINGS_PX, _SURROUNDINGS_PX))
    return noise_level(grey, np.asarray((mean > _DARKEST) & (mean < _BRIGHTEST), np.bool_))


def remaining_noise(noise: float, captures: int, scale: float) -> float:
    """What the frame has of its captures' noise, grey levels.

    So many captures are merged by their median, whose standard deviation is sqrt(pi / (2 n + pi - 2)) of one's (David and
    Nagaraja, Order Statistics, 2003; within 1 % from three on).  Of two, one is used.  scale: side of the frame over a capture's.
    """
    merged = 1.0 if captures < 3 else float(np.sqrt(np.pi / (2 * captures + np.pi - 2)))
    return noise * _MIXED * merged * min(scale, 1.0)


def denoised(image: Uint8s, noise: float) -> Uint8s:
    """A frame (h, w, 3) without most of its noise (grey levels): non-local means (Buades, Coll and Morel, CVPR 2005).

    Edges and texture that is seen again nearby stay, which a Gaussian wears down: on the yard without lamps (four cameras)
    F at 2 cm is 35.5 with it, 34.7 with a Gaussian of 1 px, 32.8 with neither.
    """
    luma, red, blue = cv2.split(cv2.cvtColor(image, cv2.COLOR_RGB2YCrCb))
    quiet = cv2.fastNlMeansDenoising(luma, None, h=noise, templateWindowSize=_PATCH_PX, searchWindowSize=_SEARCH_PX)
    luma = cv2.addWeighted(quiet, 1 - _KEPT, luma, _KEPT, 0)
    red, blue = (cv2.GaussianBlur(colour, (0, 0), _COLOUR_PX) for colour in (red, blue))
    return np.asarray(cv2.cvtColor(cv2.merge([luma, red, blue]), cv2.COLOR_YCrCb2RGB), np.uint8)
