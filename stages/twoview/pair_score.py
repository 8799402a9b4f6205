"""Score of a pair: how likely its geometry is right, from the pair's own evidence (`twoview.pair_evidence`).

Look-alike windows seen from opposite sides give a hundred or more matches that agree with one F, so the number of inliers does
not separate right pairs from wrong ones.  What does: whether the matches are *distinctive* (no rival in the other image, no
look-alike in their own) and cover the image; whether the clearest matches, found before any geometry, also agree with F; whether
both halves of the inliers give the same rotation; and how stretched the local affine maps are (wrong pairs join similar views).

Pairs that remain undecided on their own are decided by the whole site (`sfm.loops`).
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isfinite, log

from .rival_pose import RivalPose

DISTINCT_CELLS = 20
"""Distinctive matches in this many grid cells show the same structure in both images, if perhaps at another place: in scenes
without repetition, no three such pairs contradict each other (`scripts/bench_verdict.py`: at most 7 cells, in 484 triangles)."""
NO_BASELINE_DEG = 1.0
"""Both cameras may be at one place if their rays converge by less than this, degrees."""
LEAST_AGREEMENT = 0.8
"""Clear matches confirm a geometry from this agreement on, even one whose rays hardly converge."""
WEIGHTS = (0.89, 0.90, 3.37, 1.20, 2.91, 3.68, -0.27, -1.15)
"""Weights of the `terms`, fitted by `scripts/bench_verdict.py` on 299 pairs of 13 sets, photographed and rendered, most with
look-alikes.  Each scene has the same weight, and the fit is drawn toward the weights of an earlier one (walls and a courtyard).
Exact copies of a building count as right, since no single pair can distinguish them."""
LEAST_LEARNED_AGREEMENT = 0.35
"""Least agreement of a pair of learned keypoints that is believed."""
UNCONFIRMED = -1.0
"""Highest score of such a pair below that: rather wrong than right, until the site decides.  No frames of learned keypoints
contradict wrong matches along epipolar lines, and guided matching makes hundreds of them: of six wrong pairs of the fountain and
turned pictures, with up to 321 inliers and scores up to 4.1, the agreement is 0.03 to 0.25, of right ones up to 101 degrees apart
(fountain, desk, rolex) 0.48 to 0.93."""
OFFSET = -15.3
"""Score of a pair whose terms are all zero, fitted together with `WEIGHTS`."""


@dataclass(frozen=True)
class PairEvidence:
    """Inputs of the score; described in `Geometry`."""

    inliers: int
    distinct_cells: int
    distinct_share: float
    agreement: float
    half_rotation_deg: float
    stretch: float
    angle_deg: float = float("nan")
    """Median angle between the rays of the inliers, nan without a pose."""
    rival: RivalPose | None = None
    """The best competing pose; None if none was searched for, without a pose or without keypoints."""
    has_frames: bool = True
    """False: most inliers are learned keypoints, which have neither scale nor orientation."""


def pair_score(evidence: PairEvidence, contradicted: bool = False) -> float:
    """Log odds that the geometry is right.

    contradicted: the intrinsics contradict F.  The score is then at most 0, as it is if a rival pose has much support.
    With K and a search for rivals, `WEIGHTS` apply.  The weights for the other cases were fitted by logistic regression on 263
    labelled pairs of four scenes, 118 of them wrong; 5 are misclassified.
    """
    e = evidence
    cells = log(1 + e.distinct_cells)
    inliers = log(1 + e.inliers)
    stretch = log(e.stretch + 0.01)  # the addend keeps the logarithm finite for matches without any stretch
    if isfinite(e.half_rotation_deg) and isfinite(e.angle_deg) and e.rival is not None:
        score = sum(weight * term for weight, term in zip(WEIGHTS, terms(e), strict=True)) + OFFSET
    elif isfinite(e.half_rotation_deg):
        # K, but no search for rivals: matches without keypoints
        halves = log(e.half_rotation_deg + 0.01)
        score = 0.54 * cells + 8.9 * e.distinct_share + 4.8 * e.agreement + 2.7 * stretch + 0.53 * inliers - 0.84 * halves - 4.0
    else:
        # without K there is no pose, so neither half rotations nor rivals
        score = 0.9 * cells + 12.0 * e.distinct_share + 5.5 * e.agreement + 3.0 * stretch + 0.6 * inliers - 6.5
    if not e.has_frames and e.agreement < LEAST_LEARNED_AGREEMENT:
        score = min(score, UNCONFIRMED)
    is_ambiguous = e.rival is not None and e.rival.ambiguous(e.inliers)
    if contradicted or is_ambiguous:
        return min(score, 0.0)
    return score


def terms(e: PairEvidence) -> tuple[float, ...]:
    """Terms of the score of a pair with a pose and a search for rivals; the last two count against the pair, the rest for it."""
    rivals = 0 if e.rival is None else e.rival.inliers
    return (
        log(1 + e.distinct_cells),
        e.distinct_share,
        e.agreement,
        log(1 + e.inliers),
        log(e.stretch + 0.01),
        log(min(e.angle_deg, 15.0) + 0.3),  # wider angles tell no more
        log(e.half_rotation_deg + 0.01),
        log((rivals + 20) / (e.inliers + 20)),  # shrunk toward equal numbers if both are few
    )


def hardly_converging(angle_deg: float, agreement: float) -> bool:
    """Whether the clear matches agree but the rays are too nearly parallel (degrees; nan if unknown) to determine the pose: it is
    not the matches that are in doubt."""
    return angle_deg < NO_BASELINE_DEG and agreement >= LEAST_AGREEMENT


def informs_about_site(evidence: PairEvidence) -> bool:
    """Whether a rejected pair whose cameras seem to be at one place is still informative about its site: either that they are at
    one place, or, if as distinctive as right pairs, that the scene looks the same from several sides."""
    if hardly_converging(evidence.angle_deg, evidence.agreement):
        return True
    return evidence.angle_deg < NO_BASELINE_DEG and evidence.distinct_cells >= DISTINCT_CELLS


def probability(score: float) -> float:
    """Log odds as a probability."""
    bounded = max(min(score, 30.0), -30.0)  # keeps the probability strictly between 0 and 1
    return 1 / (1 + exp(-bounded))
