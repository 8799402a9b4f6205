"""Do pairs agree on depths?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

from ..records.findings import Finding, finding
from ..records.record import RunRecord
from ..task import camera_of
from .facts import Facts

MOST_DIFFERENCE_PX = 0.25
"""Largest overall difference tolerated between the depths that two pairs give to one view, pixels.  Smaller: right poses are
suspected, too (measured: 0.02 to 0.16 with right ones, 0.38 to 2.1 with a camera moved by 0.5 m or turned by 0.5 degrees)."""
MOST_DIFFERENCE_SOLVED_PX = 0.5
"""Limit instead of `MOST_DIFFERENCE_PX`, pixels, if a pose is solved, since tonight's matches determine it no better, or if dense
matching confirms the rows of the stated cameras."""
SINGLE_DIFFERENCE_FACTOR = 2.0
"""A single difference between two pairs, with no other above its limit, may exceed its own by this factor: a wrong pose shows in
more than one view or pair."""
LOOK_ALIKES_PX = 12.0
"""Larger differences between pairs, in pixels, are ignored: these pairs match different parts of a repeating pattern, and harm
only themselves (measured: 19 to 96 on a solar farm; 7 with a camera turned by 2 degrees)."""


class _Excess(NamedTuple):
    """A difference above its limit; the largest one is that with the largest factor."""

    factor: float
    """The difference as a multiple of its limit."""
    px: float
    limit: float


def check_depths(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Do pairs agree on depths?  A wrong pose or lens can shift depths along epipolar lines, where matches do not reveal it."""
    if record.poses and record.poses.contradiction:
        return  # the finding on a contradiction explains wrong depths, too
    rows_agree = record.poses is not None and record.poses.rows_agree
    solved = {camera.id for camera in record.cameras if camera.figures.pose_from == "solved"}
    too_large: list[_Excess] = []
    scores: Counter[str] = Counter()  # by camera: differences that are too large, minus those that are not
    for camera in record.cameras:
        for partners, px in (camera.figures.offset_px or {}).items():
            if px > LOOK_ALIKES_PX:
                continue
            views = partners.split("--")
            cameras = dict.fromkeys([camera.id, *(camera_of(view) for view in views)])  # each once, in this order
            limit = MOST_DIFFERENCE_PX
            if rows_agree or solved & cameras.keys():
                limit = MOST_DIFFERENCE_SOLVED_PX
            if px > limit:
                too_large.append(_Excess(px / limit, px, limit))
            for name in cameras:
                scores[name] += 1 if px > limit else -1
    if not too_large:
        return
    if len(too_large) == 1 and too_large[0].factor <= SINGLE_DIFFERENCE_FACTOR:
        return
    worst = max(too_large)
    highest = max(scores.values())
    suspects = tuple(name for name, score in scores.items() if score == highest >= 0)
    cause = "no single camera explains it; all may be slightly off"
    if suspects:
        cause = f"the pose or lens of {' or '.join(suspects)} is probably wrong"
    figures = {"offset_px": worst.px}
    expected = {"offset_px": worst.limit}
    yield finding("pairs-disagree", suspects, figures, expected, px=worst.px, limit=worst.limit, cause=cause)
