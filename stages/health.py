"""State of a camera tonight, compared with the pinned reference: in place, turned, moved, covered, or showing another scene.

An undecided case counts as `ok`, with a note that it is unverified: a night without light is no fault of the camera.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from .contracts.camera_figures import HealthState
from .contracts.defaults import DARK_LEVELS, FLAT_SHARE, MOVED_DEG, NUDGED_PX
from .core.luminance import grey_levels
from .twoview.global_search import search_globally
from .twoview.registration import Found, Turn, corners, find_again, fit_turn
from .types import Camera, CameraHealth, Float32s, Float64s, Frame, ShiftHistory, Uint8s

_TILE_PX = 16
"""Edge of the tiles in which structure is looked for, pixels."""
_SMOOTHING_PX = 2.0
"""Standard deviation of the smoothing before that, pixels: noise is no structure."""
_FLAT_SIGMA = 2.5
"""Standard deviation in grey levels of a smoothed tile; tiles below this show nothing."""
_CLEAR_SIGMA = 5.0
"""Standard deviation in grey levels from which a tile of the reference has clear structure, so that its loss means something."""
_SATURATED = 250
"""Grey level from which a pixel is saturated."""
_COLOURLESS = 0.03
"""Median saturation, 0 to 1, below which a picture counts as infrared."""
_NIGHT_LEVEL = 60.0
"""Median grey level below which it is night."""
_NO_LIGHT_LEVEL = 30.0
"""Median grey level below which a picture that shows nothing lacks light; above, its lens is covered."""
_COVERED_SHARE = 0.3
"""Share of a picture's clear tiles that must be covered for the text to mention it."""
_LEAST_CONTRAST_SHARE = 0.5
"""A picture with less than this share of the reference's contrast cannot show that the scene is another one."""
_FEWEST_NIGHTS = 5
"""Fewest earlier nights from which the sway of a camera is measured."""
_GUESSED_FOCAL = 1.2
"""Focal length in image widths, assumed if nothing is known: a turn in pixels does not depend on it."""
_SIGMAS = 3.0
"""Standard deviations that a motion must exceed to count: of its own error, and of the camera's usual sway."""
_TURNED_SHARE = 0.5
"""Smallest share of the patches found again that must agree with a turn for it to explain the picture."""
_MOST_ZOOM = 0.003
"""Largest change of zoom (relative) that still counts as a turn: with more, the lens was touched."""


@dataclass(frozen=True)
class _Statistics:
    """Statistics of a single picture."""

    brightness: float
    """Median grey level."""
    contrast: float
    """Grey levels between the 5th and the 95th percentile."""
    saturation: float
    """Median saturation, 0 to 1."""
    blinded: float
    """Share of saturated pixels."""
    structured: Float64s
    """(rows, columns) standard deviation of the tiles of the smoothed picture, nan where masked."""

    @property
    def flat(self) -> float:
        """Share of the picture's tiles that show nothing."""
        tiles = self.structured[np.isfinite(self.structured)]
        if not tiles.size:
            return 1.0
        return float((tiles < _FLAT_SIGMA).mean())

    @property
    def mode(self) -> str:
        """Kind of light: "infrared", "night" or "day"."""
        if self.saturation < _COLOURLESS:
            return "infrared"
        if self.brightness < _NIGHT_LEVEL:
            return "night"
        return "day"


@dataclass
class _Case:
    """Intermediate results of one examination, which end in the `CameraHealth` whatever its state."""

    figures: dict[str, float | str] = field(default_factory=dict)
    """Measured values, by name."""
    expected: dict[str, float | str] = field(default_factory=dict)
    """Their limits, under the same names."""
    turn: Turn | None = None
    """The turn of the camera since the reference, if its picture could be registered."""

    def closed(self, state: HealthState, text: str, remedy: str = "", corrected: bool = False) -> CameraHealth:
        """The final `CameraHealth`."""
        health = CameraHealth(state, text, self.figures, self.expected, remedy, corrected)
        if self.turn is None:
            return health
        return replace(health, turn=self.turn.R, homography=self.turn.homography)


def examine(
    frame: Frame,
    pinned_frame: Frame | None = None,
    pinned_camera: Camera | None = None,
    history: ShiftHistory | None = None,
    *,
    nudged_px: float = NUDGED_PX,
    moved_deg: float = MOVED_DEG,
    flat: float = FLAT_SHARE,
    dark: float = DARK_LEVELS,
) -> CameraHealth:
    """Compare a camera's frame with that of the reference.

    Parameters
    ----------
    frame : tonight's frame.
    pinned_frame, pinned_camera : the reference's frame, and the camera that took it; without them only the frame itself is
        judged.
    history : measurements of earlier nights, so that a camera that usually sways does not count as shifted each time.
    nudged_px : a camera counts as shifted, and its pose is corrected, if its picture has moved by more than this (median
        over the picture), in pixels of the frame.  If its usual sway, three standard deviations, is larger, that is the limit.
    moved_deg : a camera counts as moved if it has turned by more than this, in degrees.  Its pose is corrected if a turn
        explains the picture; otherwise it is solved anew from the others.
    flat : a picture counts as obscured if more than this share of it shows nothing (covered, fog, no light).
    dark : a picture also counts as obscured if its contrast (5 to 95 %) is below this, in grey levels of 255.
    """
    # 1. Does the picture show anything?
    new = _statistics(frame)
    case = _Case()
    case.figures |= {"brightness": new.brightness, "contrast": new.contrast}
    case.figures |= {"flat": new.flat, "blinded": new.blinded, "mode": new.mode}
    case.expected |= {"flat": flat, "contrast": dark}
    if new.flat > flat or new.contrast < dark:
        light = "no light" if new.brightness < _NO_LIGHT_LEVEL else "covered, dirty, or in fog"
        text = f"{100 * new.flat:.0f} % of the picture show nothing ({light})"
        return case.closed("obscured", text, "check that the lens is clear and that a lamp is on")

    # 2. Can it be compared with the reference?
    if pinned_frame is None:
        return case.closed("ok", "nothing to compare with")
    if pinned_frame.image.shape != frame.image.shape:
        text = f"its pictures have another size: {_size_text(frame)}, were {_size_text(pinned_frame)}"
        return case.closed("moved", text, "pin a new reference")
    old = _statistics(pinned_frame)
    case.figures["covered"] = _covered_share(old, new)

    # 3. Find its patches again near their old places, and the turn that explains their motion.
    K = _intrinsics(frame, pinned_camera)
    grey1 = grey_levels(pinned_frame.image)
    grey2 = grey_levels(frame.image)
    searched = corners(grey1, pinned_frame.mask & frame.mask)
    matches = find_again(grey1, grey2, searched)
    case.figures["found_again"] = len(matches.x1) / max(len(searched), 1)
    case.turn = fit_turn(matches, K, grey1.shape[1], grey1.shape[0])
    if case.turn is None:
        return _unregistered_state(case, grey1, grey2, pinned_frame, frame, K)
    case.figures["sharpness"] = _relative_sharpness(grey1, grey2, matches, case.turn)
    return _registered_state(case, case.turn, history, nudged_px, moved_deg)


def _size_text(frame: Frame) -> str:
    """Such as "1920x1080"."""
    h, w = frame.image.shape[:2]
    return f"{w}x{h}"


def _registered_state(case: _Case, turn: Turn, history: ShiftHistory | None, nudged_px: float, moved_deg: float) -> CameraHealth:
    """The state of a camera whose picture has been registered: in place, shifted, or moved."""
    limit = max(nudged_px, _sway(history))  # a mast sways every night
    case.figures |= {
        "motion_px": turn.motion_px,
        "shift_x_px": float(turn.shift[0]),
        "shift_y_px": float(turn.shift[1]),
        "shift_sigma_px": float(np.linalg.norm(turn.shift_sigma) / np.sqrt(2)),
        "turn_deg": turn.angle_deg,
        "turn_sigma_deg": turn.angle_sigma_deg,
        "roll_deg": turn.roll_deg,
        "roll_sigma_deg": turn.roll_sigma_deg,
        "zoom": turn.zoom,
        "patches": float(turn.inliers.sum()),
    }
    case.expected |= {"motion_px": limit}
    # In place: it has moved by no more than the limit, or than the error of the measurement.
    sigma = float(np.linalg.norm(turn.shift_sigma))
    if turn.motion_px <= max(limit, _SIGMAS * sigma):
        text = f"where it was, within {turn.motion_px:.2f} px"
        covered = float(case.figures["covered"])
        if covered > _COVERED_SHARE:
            text += f"; {100 * covered:.0f} % of it covered"
        return case.closed("ok", text)

    text = f"turned by {turn.angle_deg:.3f} ± {turn.angle_sigma_deg:.3f} degrees ({turn.motion_px:.1f} px)"
    zoomed = abs(turn.zoom - 1) > _MOST_ZOOM
    if not zoomed and turn.angle_deg <= moved_deg:
        return case.closed("shifted", f"{text}: corrected", "fasten it; if it stays so, pin a new reference", True)

    # Moved: a turn alone is corrected.  If few patches agree with it, near and far things disagree: it was displaced, too.
    case.expected["turn_deg"] = moved_deg
    only_turned = not zoomed and bool(turn.inliers.mean() >= _TURNED_SHARE)
    if zoomed:
        text += f", zoomed by {100 * (turn.zoom - 1):+.1f} %"
    if only_turned:
        text += ": corrected"
    return case.closed("moved", text, "turn it back, or pin a new reference", only_turned)


def _unregistered_state(case: _Case, grey1: Uint8s, grey2: Uint8s, pinned: Frame, frame: Frame, K: Float64s) -> CameraHealth:
    """The state of a camera whose picture cannot be registered near its old place."""
    # Far from its old place, patches cannot be found again: features of the whole picture are compared instead.
    search = search_globally(grey1, grey2, pinned.mask, frame.mask, K)
    case.figures |= {"matches": float(search.matches), "agreeing": float(search.agreeing)}
    if search.turn_deg is not None:
        case.figures["turn_deg"] = search.turn_deg
        return case.closed("moved", f"turned by {search.turn_deg:.2f} degrees", "turn it back, or pin a new reference")
    if search.shared:
        return case.closed("moved", "it sees the same things from another position", "move it back, or pin a new reference")
    # Another scene is claimed only from a picture taken in the same light, that shows about as much as the reference did.
    old = _statistics(pinned)
    new = _statistics(frame)
    if search.distinct and new.mode == old.mode and new.contrast > _LEAST_CONTRAST_SHARE * old.contrast:
        text = f"it shows another place: of {search.keypoints} features, {search.agreeing} agree with the reference"
        remedy = "is it the right camera on this input? If it was moved for good, pin a new reference"
        return case.closed("wrong-scene", text, remedy)
    return case.closed("ok", f"unverified: too little of the reference is recognised ({new.mode})")


def _sway(history: ShiftHistory | None) -> float:
    """Three robust standard deviations of the shifts of earlier nights, pixels; 0 if there are too few nights."""
    if history is None or len(history.shift_x_px) < _FEWEST_NIGHTS:
        return 0.0
    shifts = np.stack([history.shift_x_px, history.shift_y_px])
    # 1.4826 turns the median distance from the median place into a standard deviation, which single nights cannot spoil.
    distances = np.linalg.norm(shifts - np.median(shifts, axis=1, keepdims=True), axis=0)
    return float(_SIGMAS * 1.4826 * np.median(distances))


def _statistics(frame: Frame) -> _Statistics:
    """Statistics of the unmasked part of a picture."""
    grey = grey_levels(frame.image)
    mask = frame.mask
    if not mask.any():
        return _Statistics(0.0, 0.0, 0.0, 0.0, np.full((1, 1), np.nan))
    low, median, high = np.percentile(grey[mask], [5, 50, 95])
    highest = frame.image.max(axis=2).astype(np.float32)
    lowest = frame.image.min(axis=2).astype(np.float32)
    saturation = (highest - lowest)[mask] / np.maximum(highest[mask], 1)
    # Standard deviation within each tile; tiles that are masked in part are unknown.
    smooth = cv2.GaussianBlur(grey, (0, 0), _SMOOTHING_PX).astype(np.float64)
    structured = _in_tiles(smooth).std(axis=(1, 3))
    structured[~_in_tiles(mask).all(axis=(1, 3))] = np.nan
    return _Statistics(
        brightness=float(median),
        contrast=float(high - low),
        saturation=float(np.median(saturation)),
        blinded=float((grey[mask] >= _SATURATED).mean()),
        structured=structured,
    )


def _in_tiles(image: np.ndarray) -> np.ndarray:
    """An image (h, w) as (rows, tile, columns, tile); parts of tiles at its right and lower border are cut off."""
    rows = image.shape[0] // _TILE_PX
    columns = image.shape[1] // _TILE_PX
    return image[: rows * _TILE_PX, : columns * _TILE_PX].reshape(rows, _TILE_PX, columns, _TILE_PX)


def _covered_share(old: _Statistics, new: _Statistics) -> float:
    """Share of the tiles with clear structure in the reference that show nothing now."""
    if old.structured.shape != new.structured.shape:
        return 0.0
    clear = np.nan_to_num(old.structured) > _CLEAR_SIGMA
    if not clear.any():
        return 0.0
    return float((new.structured[clear] < _FLAT_SIGMA).mean())


def _relative_sharpness(grey1: Uint8s, grey2: Uint8s, matches: Found, turn: Turn) -> float:
    """Strength of the finest detail relative to the contrast around it: median ratio of tonight to the reference."""
    detail1 = _relative_detail(grey1, matches.x1[turn.inliers])
    detail2 = _relative_detail(grey2, matches.x2[turn.inliers])
    return float(np.median(detail2 / np.maximum(detail1, 1e-6)))


def _relative_detail(grey: Uint8s, points: Float64s) -> Float32s:
    """(n,) mean absolute Laplacian around points (n, 2), relative to the standard deviation there: light changes both alike."""
    # The Laplacian of a hardly smoothed picture: detail of a pixel or two, which blur destroys first.
    fine = np.abs(cv2.Laplacian(cv2.GaussianBlur(grey, (0, 0), 0.7), cv2.CV_32F))
    values = np.asarray(grey, dtype=np.float32)
    mean = cv2.blur(values, (15, 15))
    variance = cv2.blur(values * values, (15, 15)) - mean * mean
    spread = np.sqrt(np.maximum(variance, 1.0))
    ratio = cv2.blur(fine, (15, 15)) / spread
    x, y = np.rint(points).astype(int).T
    x = x.clip(0, grey.shape[1] - 1)
    y = y.clip(0, grey.shape[0] - 1)
    return np.asarray(ratio[y, x], dtype=np.float32)


def _intrinsics(frame: Frame, camera: Camera | None) -> Float64s:
    """(3, 3) intrinsics of the reference's camera, else of the frame, else a guess."""
    if camera is not None:
        return camera.K
    if frame.view.K is not None:
        return frame.view.K
    h, w = frame.image.shape[:2]
    f = _GUESSED_FOCAL * w
    return np.array([[f, 0.0, (w - 1) / 2], [0.0, f, (h - 1) / 2], [0.0, 0.0, 1.0]])
