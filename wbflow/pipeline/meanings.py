"""The meaning of the figures in run.json: title, explanation, and limits of good and bad, for the report and comparisons."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ..words import format_value

_MOST_NAMED = 8
"""Largest number of a figure's parts to list; those with the largest values are listed."""


@dataclass(frozen=True)
class Meaning:
    """The meaning of one figure."""

    title: str
    words: str
    good: float | None = None
    """Limit at and beyond which the figure is good."""
    bad: float | None = None
    """Limit at and beyond which it is bad; less than `good` if small values are bad, greater if large ones are."""
    share: bool = False
    """Is it a share, to be shown in percent?"""

    def grade(self, value: Any) -> str:
        """The grade of a value: good, fair or bad; "" if it cannot be graded."""
        if self.good is None or self.bad is None or isinstance(value, bool | str) or value is None:
            return ""
        sign = 1.0 if self.good > self.bad else -1.0  # of figures that are better if smaller, everything is mirrored
        if sign * value >= sign * self.good:
            return "good"
        if sign * value <= sign * self.bad:
            return "bad"
        return "fair"


MEANINGS: Mapping[str, Meaning] = {
    "matches": Meaning("matches", "points that look alike in both pictures, as do their neighbours", 100, 30),
    "inliers": Meaning(
        "inliers",
        "points that one position of the two cameras explains; more than matches where a second search, led by the first, "
        "found further ones; fewer than 30 are not enough",
        100,
        30,
    ),
    "angle_deg": Meaning(
        "angle °", "between the two views of the scene: below 4° depth is poorly determined, above 60° few points match"
    ),
    "epipolar_px": Meaning("epipolar px", "distance of inliers from their epipolar lines, median", 0.6, 1.5),
    "probability": Meaning(
        "probability", "that the geometry of this pair is right, from the spread and agreement of its matches", 0.9, 0.5
    ),
    "poses_px": Meaning("placed px", "the same distance with the poses of all cameras solved together", 0.8, 2.0),
    "known": Meaning("known", "source of the relative pose: stated in the site file, or solved"),
    "dense": Meaning("dense", "whether the pair is matched densely; such pairs are chosen once the cameras are placed"),
    "vertical_px": Meaning(
        "vertical px", "distance of matches from their common row in the rectified pictures, median", 0.6, 1.5
    ),
    "method": Meaning("method", "how the pair was resampled to common rows"),
    "verified": Meaning("verified", "evidence that confirmed the pose"),
    "row_share": Meaning("row share", "share of the common view that matches on the predicted rows"),
    "row_chance": Meaning("row chance", "the same with one picture eight rows off: what matches by chance"),
    "row_error_px": Meaning("row error px", "offset between corresponding rows, measured from the pictures", 0.5, 1.5),
    "density": Meaning("density", "share of the common view whose depth was found and confirmed from both sides", 0.3, 0.1),
    "brightness": Meaning("brightness", "mean of the picture, 0 to 255"),
    "contrast": Meaning("contrast", "standard deviation of the picture's brightness"),
    "saturated": Meaning("saturated", "share of the picture that is pure white", 0.02, 0.15),
    "sharpness": Meaning("sharpness", "of fine detail, compared with the contrast; compare it with other nights only"),
    "frames_used": Meaning("captures", "number of captures merged into the clean picture"),
    "seen_by_one": Meaning("seen by one", "share of the ground that at least one camera sees", share=True),
    "seen_by_two": Meaning("seen by two", "share of the ground that at least two cameras see", share=True),
    "lost_without": Meaning("lost without", "share of the ground that fewer than two would see without this camera", share=True),
    "area_m2": Meaning("ground, m²", "area of the ground that is considered"),
    "error_m": Meaning("expected error, m", "of points on the ground, from the distances and angles of the cameras; median"),
    "count": Meaning("things changed", "things that are new, have vanished or were moved"),
    "changed_share": Meaning("changed", "share of the compared surface that belongs to changes", share=True),
    "unknown_share": Meaning("unknown", "share of the reference's surface that was not observed tonight", share=True),
    "noise": Meaning("noise", "differences of unchanged surfaces, relative to the uncertainty of the points; 1 is ideal"),
    "points": Meaning("points", "samples that this view contributed to the cloud, before merging"),
    "misfit": Meaning(
        "error of points", "estimated from other views and neighbours, relative to the error expected from matching; median"
    ),
    "detail_px": Meaning("detail, px", "smallest detail that the picture resolves, in pixels, in the coarser direction"),
    "keypoints": Meaning("keypoints", "distinct points that were found; their number is capped by `max_keypoints`"),
}
"""Meanings by the name of the figure in run.json."""
BOOKKEEPING = frozenset({"highest_id"})
"""Figures that programs alone need; no page shows them."""


def meaning(figure: str) -> Meaning:
    """The meaning of a figure; for an unknown one, its name as the title."""
    return MEANINGS.get(figure) or Meaning(figure.replace("_", " "), "")


def shown(figures: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield title and formatted value of a stage's figures."""
    for name, value in figures.items():
        if name in BOOKKEEPING:
            continue
        format_figure = _percent if meaning(name).share else format_value
        if isinstance(value, int | float):
            yield titled(name), format_figure(value)
        elif isinstance(value, Mapping) and value and all(isinstance(entry, int | float) for entry in value.values()):
            largest_first = sorted(value.items(), key=lambda entry: -entry[1])
            parts = [f"{key} {format_figure(number)}" for key, number in largest_first[:_MOST_NAMED]]
            text = ", ".join(parts)
            if len(largest_first) > _MOST_NAMED:
                text += f"; {len(largest_first) - _MOST_NAMED} others less"
            yield titled(name), text


def titled(name: str) -> str:
    """The title of a figure; for an unknown one, its name with the unit in parentheses."""
    if name in MEANINGS:
        return MEANINGS[name].title
    words, _, unit = name.rpartition("_")
    title = name
    if unit == "deg":
        title = f"{words} (degrees)"
    elif unit in {"m", "m2"}:
        title = f"{words} ({unit})"
    return title.replace("_", " ")


def _percent(share: float) -> str:
    if 0 < share < 0.1:
        return f"{100 * share:.1f} %"
    return f"{100 * share:.0f} %"
