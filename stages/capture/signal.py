"""Artefacts of a camera's electronics and coding: combing, coding blocks, colour cast, missing colour, noise.

Interlaced cameras read every second row a moment later, and a poor signal line shifts these rows as a whole.  Recorders that are
short of disk space code blocks of 8 x 8 pixels so coarsely that the block edges are stronger than those of the scene.

Noise is measured where it is white, in the captures as they come from the camera: undistortion mixes neighbouring pixels, after
which noise of eleven grey levels is measured as two."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ..core.luminance import block_means, grey_levels, noise_level
from ..types import Float32s, Uint8s

_TILE_PX = 16
"""Side of the tiles that are tested for combing, pixels."""
_LEAST_STRUCTURE = 3.0
"""Mean grey-level difference of neighbouring pixels of a row above which a tile is tested for combing."""
_COMBED_RATIO = 1.3
"""Smallest ratio of the difference between adjacent rows to that between rows two apart for a tile to count as combed."""
_MOST_COMBED = 0.1
"""Share of combed tiles from which on only one field is used."""
_LEAST_SHIFT_PX = 0.3
"""Smallest horizontal shift of the second field that is corrected, pixels; images without combing measure below 0.03."""
_MOST_SHIFT_PX = 6.0
"""Largest horizontal shift of the second field that is searched for, pixels."""
_ACCEPTED_RATIO = 0.8
"""Largest ratio of row-to-row differences after a shift to those before it for the shift to be accepted."""
_MIDDLE_PX = 1024
"""Side of the central part of an image that is analysed."""
_BLOCK_PX = 8
"""Side of the blocks of JPEG and of older video codings, pixels."""
_BLOCKY_RATIO = 1.5
"""Ratio of the steps at block borders to those within blocks above which coarse coding is reported: it hides the scene."""
_CAST_RATIO = 1.7
"""Ratio of the strongest to the weakest mean channel above which a colour cast is reported; usual lamps stay below."""
_COLOURLESS = 0.05
"""Median saturation, after removal of a colour cast, below which an image is reported as without colour."""


@dataclass(frozen=True)
class Signal:
    """Signal statistics of one image, or their median over several; for the fields see `Frame`."""

    combing: float = 0.0
    blocking: float = 1.0
    cast: float = 1.0
    colour: float = 1.0
    noise: float = 0.0

    @classmethod
    def median(cls, several: Sequence[Signal]) -> Signal:
        """The median of each field over several images."""
        medians = {}
        for name in cls.__dataclass_fields__:
            medians[name] = float(np.median([getattr(signal, name) for signal in several]))
        return cls(**medians)

    def words(self) -> list[str]:
        """Warnings for the operator."""
        warnings = []
        if self.blocking > _BLOCKY_RATIO:
            warnings.append(
                f"coded coarsely: blocks of 8 pixels stand out {self.blocking:.1f}-fold; have it recorded at a higher quality"
            )
        if self.colour < _COLOURLESS:
            warnings.append("without colour: infrared light, or a grey camera")
        elif self.cast > _CAST_RATIO:
            warnings.append(f"a cast of colour: one is {self.cast:.1f} times another; look at its white balance")
        return warnings


def signal_of(image: Uint8s) -> Signal:
    """Signal statistics of an image (h, w, 3) as it comes from the camera."""
    image = _central_part(image)
    grey = np.asarray(grey_levels(image), np.float32)
    means = np.maximum(np.array(cv2.mean(image)[:3]), 1.0)
    # saturation without the cast: channels scaled to equal means ("grey world"); a sixteenth of the pixels is enough
    balanced = image[::4, ::4].astype(np.float32) * (means.mean() / means).astype(np.float32)
    high = balanced.max(axis=2)
    low = balanced.min(axis=2)
    saturation = float(np.median((high - low) / np.maximum(high, 1.0)))
    return Signal(_combing(grey), _blocking(grey), float(means.max() / means.min()), saturation, capture_noise(grey))


def _central_part(image: Uint8s) -> Uint8s:
    """The centre of an image, cut at an even row so that each row stays in its field."""
    height, width = image.shape[:2]
    top = max(height - _MIDDLE_PX, 0) // 2 // 2 * 2
    left = max(width - _MIDDLE_PX, 0) // 2 // 2 * 2
    return image[top : top + _MIDDLE_PX, left : left + _MIDDLE_PX]


def _combing(grey: Float32s) -> float:
    """Share of the tiles with structure along their rows in which adjacent rows of (h, w) differ more than rows two apart."""
    # differences to the row above (of the other field), to the row above that one, and to the pixel at the left
    near = np.abs(grey[2:] - grey[1:-1])
    far = np.abs(grey[2:] - grey[:-2])
    along = np.abs(np.diff(grey, axis=1))[2:]
    near_tiles = block_means(near[:, 1:], _TILE_PX)
    far_tiles = block_means(far[:, 1:], _TILE_PX)
    structured = block_means(along, _TILE_PX) > _LEAST_STRUCTURE
    if structured.sum() < 8:  # too few tiles for a share
        return 0.0
    return float((near_tiles > _COMBED_RATIO * far_tiles)[structured].mean())


def _blocking(grey: Float32s) -> float:
    """Ratio of steps at block borders to the median step, the lower of both directions; blocks may begin at any pixel (crops)."""
    column_steps = np.abs(np.diff(grey, axis=1)).mean(axis=0)
    row_steps = np.abs(np.diff(grey, axis=0)).mean(axis=1)
    ratios = []
    for steps in (column_steps, row_steps):
        count = len(steps) // _BLOCK_PX * _BLOCK_PX
        if count < 4 * _BLOCK_PX:  # fewer than four blocks
            return 1.0
        # the mean step at each of the eight positions within a block: borders lie at one of them
        phases = steps[:count].reshape(-1, _BLOCK_PX).mean(axis=0)
        ratios.append(float(phases.max() / max(np.median(phases), 0.1)))
    return min(ratios)


def repaired(image: Uint8s) -> tuple[Uint8s, str]:
    """The image (h, w, 3) without combing, and what was done in words; the image itself and "" if it is not combed.

    If the second field is shifted as a whole, it is shifted back; otherwise its rows are interpolated from the first field.
    """
    grey = np.asarray(grey_levels(_central_part(image)), np.float32)
    shift = _field_shift(grey)
    if _LEAST_SHIFT_PX < abs(shift) <= _MOST_SHIFT_PX:
        shifted = image.copy()
        shifted[1::2] = _shift_left(image[1::2], shift)
        new_grey = np.asarray(grey_levels(_central_part(shifted)), np.float32)
        is_smoother = _row_difference(new_grey) < _ACCEPTED_RATIO * _row_difference(grey)
        if is_smoother and _combing(new_grey) < 0.5 * _MOST_COMBED:
            return shifted, "every second row is displaced, and is shifted back"
    if _combing(grey) < _MOST_COMBED:
        return image, ""
    first_field = image[::2]
    next_rows = np.concatenate([first_field[1:], first_field[-1:]])[: len(image) // 2]
    interpolated = image.copy()
    interpolated[1::2] = cv2.addWeighted(first_field[: len(next_rows)], 0.5, next_rows, 0.5, 0)
    return interpolated, "every second row is from another moment (interlaced), and is not used"


def _row_difference(grey: Float32s) -> float:
    return float(np.abs(np.diff(grey, axis=0)).mean())


def _field_shift(grey: Float32s) -> float:
    """Shift of the second field to the right, against the mean of its neighbouring rows, pixels (Lucas and Kanade, 1981)."""
    if min(grey.shape) < 32:
        return 0.0
    first_field = grey[::2]
    second_field = grey[1::2]
    rows = min(len(first_field) - 1, len(second_field))
    expected = 0.5 * (first_field[:rows] + first_field[1 : rows + 1])
    actual = second_field[:rows]

    # 1. the best whole number of pixels; 8 pixels at each side are left out, since `roll` fills them from the other side
    shifts = np.arange(-_MOST_SHIFT_PX, _MOST_SHIFT_PX + 1)
    differences = [np.abs(np.roll(expected, int(shift), axis=1) - actual)[:, 8:-8].mean() for shift in shifts]
    best_shift = float(shifts[np.argmin(differences)])

    # 2. the fraction: least squares on the slope, actual = shifted - slope * d
    shifted = np.roll(expected, int(best_shift), axis=1)
    slope = 0.5 * (np.roll(shifted, -1, axis=1) - np.roll(shifted, 1, axis=1))
    inner = (slice(None), slice(8, -8))
    return best_shift - float((slope * (actual - shifted))[inner].sum() / max((slope * slope)[inner].sum(), 1e-6))


def _shift_left(rows: Uint8s, shift: float) -> Uint8s:
    """(h, w, 3) rows moved to the left by a shift in pixels."""
    columns = np.arange(rows.shape[1], dtype=np.float32) + np.float32(shift)
    x, y = np.meshgrid(columns, np.arange(len(rows), dtype=np.float32))
    return np.asarray(cv2.remap(rows, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE), np.uint8)


NOISY = 2.0
"""Noise of a frame (standard deviation in grey levels) from which on it is denoised."""
_DARKEST = 12.0
"""Smallest local mean grey level at which noise is measured: clipped areas have none."""
_BRIGHTEST = 243.0
"""Largest local mean grey level at which noise is measured."""
_SURROUNDINGS_PX = 16
"""Side of the square over which the local mean is taken, pixels."""
_INTERPOLATED_NOISE = 0.67
"""Share of the standard deviation of white noise that bilinear interpolation leaves: 2/3, the mean over all fractions."""
_PATCH_PX = 7
"""Side of the patches that non-local means compare, pixels."""
_SEARCH_PX = 21
"""Side of the square in which similar patches are searched for, pixels."""
_KEPT_NOISE = 0.35
"""Share of the noise that is kept.  Without it, uniform surfaces show only artefacts of denoising, alike in all views by chance
(measured without light: 77 % of the points within 5 cm, 61 % without it, 71 % with 0.2, 76 % with 0.5)."""
_COLOUR_PX = 2.0
"""Sigma of the Gaussian that smooths the colours, pixels: they carry little shape, and their noise is coarse."""


def capture_noise(grey: Float32s) -> float:
    """Standard deviation of the noise of a capture (h, w) as it comes from the camera, grey levels."""
    mean = cv2.blur(grey, (_SURROUNDINGS_PX, _SURROUNDINGS_PX))
    return noise_level(grey, np.asarray((mean > _DARKEST) & (mean < _BRIGHTEST), np.bool_))


def remaining_noise(noise: float, captures: int, scale: float) -> float:
    """Noise of a frame, in grey levels, from the noise of its captures.

    The median of n captures has sqrt(pi / (2 n + pi - 2)) of the standard deviation of one (David and Nagaraja, Order
    Statistics, 2003; within 1 % from three on).  Of two captures one is used.  scale: side of the frame over that of a capture.
    """
    merged = 1.0
    if captures >= 3:
        merged = float(np.sqrt(np.pi / (2 * captures + np.pi - 2)))
    return noise * _INTERPOLATED_NOISE * merged * min(scale, 1.0)


def denoised(image: Uint8s, noise: float) -> Uint8s:
    """A frame (h, w, 3) without most of its noise (grey levels): non-local means (Buades, Coll and Morel, CVPR 2005).

    It keeps edges and repeated texture, which a Gaussian blurs: on the yard without lamps (four cameras) the F-score at 2 cm is
    35.5 with it, 34.7 with a Gaussian of 1 px, and 32.8 without denoising.
    """
    luma, red, blue = cv2.split(cv2.cvtColor(image, cv2.COLOR_RGB2YCrCb))
    denoised_luma = cv2.fastNlMeansDenoising(luma, None, h=noise, templateWindowSize=_PATCH_PX, searchWindowSize=_SEARCH_PX)
    luma = cv2.addWeighted(denoised_luma, 1 - _KEPT_NOISE, luma, _KEPT_NOISE, 0)
    red = cv2.GaussianBlur(red, (0, 0), _COLOUR_PX)
    blue = cv2.GaussianBlur(blue, (0, 0), _COLOUR_PX)
    return np.asarray(cv2.cvtColor(cv2.merge([luma, red, blue]), cv2.COLOR_YCrCb2RGB), np.uint8)
