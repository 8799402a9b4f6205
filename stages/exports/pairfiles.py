"""The result of one pair as files that other programs read: matches, F, rectified images, disparity, a picture of each step."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..io.rasters import pfm, png
from ..rectification.warping import disparity_px, warp
from ..types import Disparity, Float64s, Frame, Geometry, Matches, Rectification
from .previews import disparity_preview, matches_preview, rectified_preview

PNG_STEPS = 16
"""Steps of the 16-bit disparity image per pixel of disparity."""
FULL = 10_000
"""Width limit in pixels that keeps the pictures as large as the frames."""
_RECTIFICATION_FIGURES = ("method", "reason", "H1", "H2", "disparity_min_px", "disparity_max_px")
"""Fields of a rectification that enter the summary."""


def pair_files(
    left: Frame,
    right: Frame,
    matches: Matches,
    geometry: Geometry | None,
    rectification: Rectification | None,
    disparity: Disparity | None,
) -> tuple[dict[str, bytes], dict[str, Any]]:
    """All files of a pair by name, as far as its processing got, and JSON data for a summary.

    Parameters
    ----------
    left, right : the frames of the pair.
    matches : of the pair.
    geometry, rectification, disparity : later results of the pair; None if it did not get so far.
    """
    files = {}
    summary: dict[str, Any] = {}
    files["matches.csv"] = _csv_table(matches)
    files["1-matches.jpg"] = bytes(matches_preview(matches, left, right, width=FULL))
    if geometry is not None:
        files["inliers.csv"] = _csv_table(geometry)
        files["F.txt"] = _matrix_text(geometry.F)
        files["2-inliers.jpg"] = bytes(matches_preview(geometry, left, right, width=FULL))
    if rectification is not None:
        files["left-rectified.png"] = png(warp(rectification, 1, left.image))
        files["right-rectified.png"] = png(warp(rectification, 2, right.image))
        files["3-rectified.jpg"] = bytes(rectified_preview(rectification, left, right, width=FULL))
        for name in _RECTIFICATION_FIGURES:
            summary[f"rectification_{name}"] = _json_value(getattr(rectification, name))
    # a disparity refers to the rectified images
    if rectification is not None and disparity is not None:
        disparity_files, offset = _disparity_files(disparity, rectification, left, right)
        files |= disparity_files
        summary["png_offset_px"] = offset
        summary["png_steps_per_px"] = PNG_STEPS
    return files, summary


def _matrix_text(matrix: Float64s) -> bytes:
    """A matrix as text, a row to a line, with digits enough for any use of F."""
    lines = []
    for row in matrix:
        lines.append(" ".join(f"{value:.12e}" for value in row) + "\n")
    return "".join(lines).encode()


def _disparity_files(
    disparity: Disparity, rectification: Rectification, left: Frame, right: Frame
) -> tuple[dict[str, bytes], int]:
    """Disparity of both rectified views as 16-bit PNG and PFM, a picture, and the offset of the PNGs in pixels.

    PNG: 0 is unknown, else disparity = (value - 1) / 16 + offset.  PFM: float32, bottom row first, infinite where unknown.
    """
    maps = {"left": disparity_px(disparity, 1), "right": disparity_px(disparity, 2)}
    # both PNGs count from one offset, a whole pixel below all disparities
    known = np.concatenate([values[np.isfinite(values)] for values in maps.values()])
    offset = 0
    if known.size:
        offset = int(np.floor(known.min()))
    files = {"4-disparity.jpg": bytes(disparity_preview(disparity, left, right, rectification, width=FULL))}
    for name, values in maps.items():
        steps = np.nan_to_num((values - offset) * PNG_STEPS + 1, nan=0.0)
        files[f"{name}-disparity.png"] = png(np.clip(np.round(steps), 0, 65535).astype(np.uint16))
        files[f"{name}-disparity.pfm"] = pfm(values)
    return files, offset


def _json_value(value: Any) -> Any:
    """A figure as JSON can hold it: arrays as lists, unknown numbers as null."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


def _csv_table(matches: Matches | Geometry) -> bytes:
    """A row for each match: its pixels in both frames, and the probability that it is right."""
    lines = ["x1,y1,x2,y2,probability"]
    # lists, as numbers of numpy take several times as long to write
    columns = (matches.x1.tolist(), matches.x2.tolist(), matches.probability.tolist())
    for (x1, y1), (x2, y2), p in zip(*columns, strict=True):
        lines.append(f"{x1:.3f},{y1:.3f},{x2:.3f},{y2:.3f},{p:.4f}")
    return ("\n".join(lines) + "\n").encode()
