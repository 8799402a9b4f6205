"""Point correspondences of a pair: one matcher by name, its result as `Matches`."""

from __future__ import annotations

from dataclasses import replace

from .core.methods import bind
from .reasons import Reason, Rejected
from .types import Features, Frame, Matches

MATCHERS = {
    "structural": "wbflow_stages.matching.structural:match_structural",
    "hao2011-dominance": "wbflow_stages.matching.hao2011:match_hao2011_dominance",
    "hao2011": "wbflow_stages.matching.hao2011:match_hao2011",
    "mutual": "wbflow_stages.matching.nearest_neighbour:match_mutual",
    "kdtree": "wbflow_stages.matching.nearest_neighbour:match_kdtree",
    "onnx": "wbflow_stages.matching.learned:match_onnx",
}
"""Sparse matchers by name.  One asks by argument name for what it reads: `left`, `right` (`Features`), `left_frame`,
`right_frame` (`Frame`); its own parameters are keyword-only, with defaults.  What it returns has keypoints
(`matching.matcher.keypoint_matches`), or is points of any other origin, with None for i1, i2 and affine."""


def match(
    left: Features,
    right: Features,
    *,
    left_frame: Frame | None = None,
    right_frame: Frame | None = None,
    matcher: str = "structural",
    min_matches: int = 8,
    **options: object,
) -> Matches | Rejected:
    """Find corresponding points of two frames, before any geometry.

    Raises ValueError where there is no such matcher, or it needs the frames, and TypeError for a parameter that it does not read.

    Parameters
    ----------
    left, right : keypoints of the two frames.
    left_frame, right_frame : the frames themselves, for matchers that ask for them.
    matcher : "structural" (descriptors and local affine structure together); for study "hao2011" (Hao 2011, section 3.3.2, to the
        letter) and "hao2011-dominance" (the same with a dominance test that can fire); rivals "mutual" (mutual nearest neighbours
        under a ratio both ways) and "kdtree" (Lowe's, through FLANN); "onnx" (a learned one, whose `model: PATH` you bring); or a
        function of your own, `package.module:function`.
    min_matches : fewer than this reject the pair.
    options : parameters of the matcher, see its function.

    References: W. Hao, wide-baseline stereo, 2011, chapter 3.
    """
    inputs = {"left": left, "right": right, "left_frame": left_frame, "right_frame": right_frame}
    found: Matches | Rejected = bind(MATCHERS, matcher, inputs, options)()
    if isinstance(found, Rejected):
        return found
    if len(found.x1) < min_matches:
        return Rejected(Reason.TOO_FEW_MATCHES, {"matches": len(found.x1), "needed": min_matches})
    return replace(found, matcher=matcher)
