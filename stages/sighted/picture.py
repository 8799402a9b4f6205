"""A picture that shows what was found in a recording, so that a person sees at once whether it is the thing."""

from __future__ import annotations

import cv2
import numpy as np

from ..io.rasters import jpeg
from ..types import Float64s, Uint8s
from .rows import Rows

_WIDEST = 1280
"""Largest side of the picture, pixels."""
_QUALITY = 85
"""Of the JPEG, 0 to 100."""
_DIMMED = 0.55
"""Brightness of the background, so that marks are seen on it."""
_LONGEST_LINE_S = 1.0
"""Places of a thing are joined by a line if no more than this is between them."""


def found_picture(background: Uint8s, rows: Rows, title: str, is_track: bool) -> bytes:
    """JPEG of a recording with the places at which things were found, from blue (first) to red (last).

    Parameters
    ----------
    background : (h, w, 3) uint8 BGR.
    rows : the places.
    title : one line of text.
    is_track : places of a thing are joined, and the seconds of some are written beside them.
    """
    scale = min(1.0, _WIDEST / max(background.shape[:2]))
    small = cv2.resize(background, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    picture = np.asarray(small * _DIMMED, np.uint8)
    xy = (rows.xy + 0.5) * scale - 0.5
    colours = _colours(rows)
    for k, (x, y) in enumerate(xy.tolist()):
        colour = tuple(map(int, colours[k]))
        at = (round(x), round(y))
        if is_track and k > 0 and rows.times[k] - rows.times[k - 1] <= _LONGEST_LINE_S and rows.things[k] == rows.things[k - 1]:
            before = (round(float(xy[k - 1, 0])), round(float(xy[k - 1, 1])))
            cv2.line(picture, before, at, colour, 1, cv2.LINE_AA)
        cv2.circle(picture, at, 2, colour, -1, cv2.LINE_AA)
    if is_track:
        _write_seconds(picture, rows.times, xy)
    titled = cv2.copyMakeBorder(picture, 26, 0, 0, 0, cv2.BORDER_CONSTANT, value=(30, 30, 30))
    cv2.putText(titled, title, (8, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (240, 240, 240), 1, cv2.LINE_AA)
    return jpeg(np.asarray(cv2.cvtColor(titled, cv2.COLOR_BGR2RGB), np.uint8), _QUALITY).tobytes()


def _colours(rows: Rows) -> Uint8s:
    """(n, 3) uint8 BGR by time."""
    if len(rows) == 0:
        return np.zeros((0, 3), np.uint8)
    share = (rows.times - rows.times.min()) / max(float(np.ptp(rows.times)), 1e-9)
    levels = np.round(255 * share).astype(np.uint8)
    return np.asarray(cv2.applyColorMap(levels[:, None], cv2.COLORMAP_TURBO), np.uint8).reshape(-1, 3)


def _write_seconds(picture: Uint8s, times: Float64s, xy: Float64s) -> None:
    """Write the seconds since the first place beside about eight of them."""
    for k in range(0, len(times), max(1, len(times) // 8)):
        at = (round(float(xy[k, 0])) + 6, round(float(xy[k, 1])) - 6)
        text = f"{times[k] - times[0]:.0f} s"
        cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 3, cv2.LINE_AA)
        cv2.putText(picture, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 255), 1, cv2.LINE_AA)
