"""Point correspondences of a pair: one matcher by name, its result as `Matches`."""

from __future__ import annotations

from dataclasses import replace

from .contracts.reasons import Reason, Rejected
from .core.methods import bind
from .types import Features, Frame, Matches
from .types.checking import require

MATCHERS = {
    "structural": "wbflow_stages.matching.structural:match_structural",
    "hao2011-dominance": "wbflow_stages.matching.hao2011:match_hao2011_dominance",
    "hao2011": "wbflow_stages.matching.hao2011:match_hao2011",
    "mutual": "wbflow_stages.matching.nearest_neighbour:match_mutual",
    "kdtree": "wbflow_stages.matching.nearest_neighbour:match_kdtree",
    "lightglue": "wbflow_stages.matching.lightglue:match_lightglue",
    "onnx": "wbflow_stages.matching.learned:match_onnx",
}
"""Sparse matchers by name.  A matcher takes its inputs by argument name: `left`, `right` (`Features`), `left_frame`,
`right_frame` (`Frame`); its own parameters are keyword-only, with defaults.  It returns matches of keypoints
(`matching.matcher.keypoint_matches`), or points of any other origin, with None for i1, i2 and affine."""


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

    Raises ValueError for an argument of a wrong type, an unknown matcher or missing frames, TypeError for a parameter that the
    matcher does not have.

    Parameters
    ----------
    left, right : keypoints of the two frames.
    left_frame, right_frame : the frames themselves, for matchers that take them.
    matcher : "structural": descriptors and local affine structure together; "hao2011": section 3.3.2 of Hao (2011) to the
        letter, for study; "hao2011-dominance": the same with a dominance test that can take effect; "mutual": mutual nearest
        neighbours with a ratio test both ways; "kdtree": Lowe's ratio test through FLANN; "lightglue": LightGlue on the
        keypoints of `features`, and "onnx": features and matcher as one model of two images, whose file you supply as
        `model: PATH`; or a function of your own, `package.module:function`.
    min_matches : reject a pair with fewer matches.
    options : parameters of the matcher, see its function.

    References: W. Hao, wide-baseline stereo, 2011, chapter 3.
    """
    require(Features, left=left, right=right)
    inputs = {"left": left, "right": right, "left_frame": left_frame, "right_frame": right_frame}
    matches: Matches | Rejected = bind(MATCHERS, matcher, inputs, options, Matches | Rejected)()
    if isinstance(matches, Rejected):
        return matches
    # a matcher returns what it finds, however little: the limit is the stage's, the same for all of them
    if len(matches.x1) < min_matches:
        return Rejected(Reason.TOO_FEW_MATCHES, {"matches": len(matches.x1), "needed": min_matches})
    return replace(matches, matcher=matcher)
