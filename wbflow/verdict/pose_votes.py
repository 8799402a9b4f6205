"""Pairs of cameras with stated poses as witnesses: does dense matching, or do their matches, agree with these poses?"""

from __future__ import annotations

from collections.abc import Iterable

from wbflow_stages.contracts.pose_figures import PoseIssue

from ..records.record import PairRecord, RunRecord

LEAST_PROBABILITY = 0.8
"""A pair contradicts a stated pose only if it is right with at least this probability (odds of four to one)."""
LINES_PX = 1.0
"""A pair agrees with stated poses if its matches lie at most this far from the epipolar lines, pixels, as in
`orientation.pose_check` (measured: matches of look-alikes lie 1.5 to 20 off)."""
ROWS_PX = 0.7
"""A pair agrees with stated poses if its rows, by dense matching, are off by at most this, pixels (measured: 0 to 0.65 with right
poses, 1.6 with a camera tilted by 0.5 degrees)."""


def among_stated(pairs: Iterable[PairRecord], record: RunRecord) -> list[PairRecord]:
    """Return the pairs whose cameras both have stated poses."""
    return [pair for pair in pairs if record.stated.issuperset(pair.cameras)]


def is_refuted(issue: PoseIssue, record: RunRecord) -> bool:
    """Do a camera's pairs with others of stated pose agree with its own after all?

    If whole surfaces match on the rows that the poses give, matches far from these rows are of look-alikes.  Pairs vote as in
    `orientation.pose_check.verified`.
    """
    if issue.triplets:  # others than pairs contradict the pose, so pairs alone cannot clear it
        return False
    votes = [_agrees_with_poses(pair) for pair in among_stated(record.pairs_of(issue.camera), record)]
    agreeing = votes.count(True)
    contradicting = votes.count(False)
    # of as many on both sides, two that agree are more than chance: look-alikes agree with poses only by accident
    return agreeing > contradicting or agreeing == contradicting >= 2


def _agrees_with_poses(pair: PairRecord) -> bool | None:
    """Does a pair agree with its stated poses?  None if that is undecided."""
    figures = pair.figures
    if figures.verified == "dense" and abs(figures.row_error_px or 0.0) <= ROWS_PX:
        return True
    if figures.poses_px is None or figures.probability is None or figures.probability < 0.5:
        return None
    if figures.poses_px <= LINES_PX:
        return True
    if figures.probability >= LEAST_PROBABILITY:
        return False
    return None
