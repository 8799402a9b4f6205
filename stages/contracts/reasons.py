"""Why a stage found nothing usable: a code that can be counted, figures, and a message made from both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, TypeVar

_LOOP_FIGURES = (
    " (score {score:.1f}, {distinct_cells:.0f} cells with distinctive matches, {closed:.0f} of {triangles:.0f} triangles close)"
)


class Reason(StrEnum):
    """All reasons of the stages.  The value is the code; `template` makes the message from the figures of a `Rejected`."""

    template: str

    def __new__(cls, code: str, template: str = "") -> Reason:
        member = str.__new__(cls, code)
        member._value_ = code
        member.template = template
        return member

    TOO_FEW_KEYPOINTS = (
        "too-few-keypoints",
        "{keypoints:.0f} keypoints, {needed:.0f} needed: the frame is empty, blurred or masked",
    )

    TOO_FEW_MATCHES = "too-few-matches", "too few: {matches:.0f} matches, {needed:.0f} needed"

    TOO_FEW_INLIERS = "too-few-inliers", "too few: {inliers:.0f} inliers of {matches:.0f} matches, {needed:.0f} needed"
    CLUSTERED = "clustered", "too clustered: {inliers:.0f} inliers on {area_share:.2%} of the image, {needed_share:.2%} needed"
    PURE_ROTATION = "pure-rotation", "pure rotation: it explains {rotation_share:.0%} of the inliers without a baseline"
    PLANAR_OR_ROTATION = (
        "planar-or-rotation",
        "planar scene or pure rotation: a homography explains {homography_share:.0%} of the inliers, and no E is known",
    )
    WRONG_MATCHES = (
        "wrong-matches",
        "wrong: {inliers:.0f} inliers agree with each other, but only {distinct_cells:.0f} of {cells:.0f} cells have distinctive "
        "ones, and only {agreement:.0%} of the clear matches agree with them",
    )

    ONE_CAMERA = "one-camera", "a cloud needs two or more cameras that see the same things"
    NO_POSED_CAMERA = "no-posed-camera", "no camera has a pose and intrinsics"
    NO_GEOMETRY = "no-geometry", "no two cameras could be placed: no pair has a geometry"
    PAIRS_CONTRADICT = "pairs-contradict", "no two cameras could be placed: the pairs contradict each other"
    NOTHING_CONFIRMED = (
        "nothing-confirmed",
        "no two cameras could be placed: {unconfirmed:.0f} of {pairs:.0f} pairs may be look-alikes, and no third camera "
        "confirms them",
    )
    NOTHING_BELIEVED = (
        "nothing-believed",
        "no two cameras could be placed: none of the {pairs:.0f} pairs is more likely right than wrong",
    )
    NOTHING_DISTINCT = (
        "nothing-distinct",
        "no two cameras could be placed: {ambiguous:.0f} of {pairs:.0f} pairs fit another pose equally well, because the scene "
        "repeats or looks the same from several sides",
    )
    TOO_FEW_POINTS = "too-few-points", "no two cameras could be placed: too few points are seen at an angle"

    NO_USABLE_BASELINE = (
        "no-usable-baseline",
        "no usable baseline: the rays of the matches meet at {angle_deg:.2f} degrees at most, {needed_deg:g} needed; the scene "
        "is some {baselines:.0f} baselines away",
    )
    NO_USABLE_BASELINE_M = (
        "no-usable-baseline-m",
        "no usable baseline: the cameras are at most {baseline_m:.2g} m apart and the scene some {distance_m:.0f} m away, so "
        "that the rays of the matches meet at {angle_deg:.2f} degrees at most, {needed_deg:g} needed",
    )

    UNCONFIRMED = "unconfirmed", "possible look-alike: no third camera confirms it" + _LOOP_FIGURES
    LOOK_ALIKE = "look-alike", "possible look-alike: other pairs contradict it" + _LOOP_FIGURES
    AMBIGUOUS = "ambiguous", "ambiguous: another pose fits equally well" + _LOOP_FIGURES
    SAME_FROM_OTHER_SIDES = (
        "same-from-other-sides",
        "ambiguous: the scene looks the same from several sides, and no distinctive match decides" + _LOOP_FIGURES,
    )
    SAME_ALONG_A_ROW = (
        "same-along-a-row",
        "ambiguous: the scene repeats along a row, and no distinctive match decides" + _LOOP_FIGURES,
    )
    NOT_BELIEVED = "not-believed", "wrong" + _LOOP_FIGURES
    TURNED = "turned", "wrong: turned by {turned_deg:.1f} degrees relative to the most probable pairs"
    CONTRADICTS_ROTATIONS = "contradicts-rotations", "contradicts the other pairs: its rotation is off by {off_deg:.0f} degrees"
    CONTRADICTS_CAMERAS = (
        "contradicts-cameras",
        "contradicts the other pairs: its inliers are {epipolar_px:.1f} px off the epipolar lines of the solved cameras",
    )
    MATCHES_CONTRADICT_CAMERAS = (
        "matches-contradict-cameras",
        "its matches are {epipolar_px:.1f} px off the epipolar lines of the known poses, and are ignored",
    )
    CAMERA_NOT_PLACED = "camera-not-placed", "one of its cameras could not be placed"
    CAMERAS_APART = "cameras-apart", "its cameras could not be brought into one frame"

    UNLIKELY_GEOMETRY = "unlikely-geometry", "F is more likely wrong than right: too few distinctive matches agree with it"
    IMPLAUSIBLE_INTRINSICS = (
        "implausible-intrinsics",
        "F implies implausible intrinsics: it is wrong, or the fields of view must be given",
    )
    CAMERAS_CONTRADICT_MATCHES = "cameras-contradict-matches", "the cameras contradict the matches"
    NOTHING_KNOWN = "nothing-known", "neither matches nor cameras determine the relative pose of the two views"
    NOTHING_IN_COMMON = "nothing-in-common", "the cameras see nothing in common where the scene is expected"
    ROWS_NOT_CONFIRMED = (
        "rows-not-confirmed",
        "dense matching does not confirm the cameras: {row_share:.1%} of the common area matches on the predicted rows, and "
        "{row_chance:.1%} by chance (eight rows off)",
    )
    NO_BASELINE = "no-baseline", "almost no baseline: the rays converge by {angle_deg:.2f} degrees, {needed_deg:g} needed"
    NO_PARALLAX = "no-parallax", "one homography explains the pair: almost no baseline, or a flat scene"
    EPIPOLE_AMONG_MATCHES = "epipole-among-matches", "the matches lie on both sides of the epipole: F is wrong"
    TOO_FEW_EPIPOLAR_LINES = "too-few-epipolar-lines", "both images see too few common epipolar lines"
    ROW_ORDER = "row-order", "the order of the matches along the rows differs: F is wrong"
    MIRRORED = "mirrored", "one image would be mirrored"
    UNCERTAIN_ROWS = "uncertain-rows", "the matches are too few or too clustered to determine the epipolar lines"

    NO_OBSERVATIONS = "no-observations", "there are no observations of things"
    ONE_OBSERVING_CAMERA = (
        "one-observing-camera",
        "{cameras:.0f} cameras have observations and a known lens; two or more are needed",
    )
    NEVER_SEEN_TOGETHER = (
        "never-seen-together",
        "no two cameras see a thing at the same time, whatever their clocks: {moments:.0f} moments at most, {needed:.0f} needed",
    )
    OBSERVED_ON_A_LINE = (
        "observed-on-a-line",
        "{lines:.0f} of {cameras:.0f} cameras see the thing on one straight line only, which determines no poses: move it up and "
        "down, and to and fro",
    )
    OBSERVED_IN_A_PLANE = (
        "observed-in-a-plane",
        "the thing moves in a plane, so that two poses of the two cameras fit equally well: raise and lower it, or add a camera",
    )
    OBSERVATIONS_DISAGREE = (
        "observations-disagree",
        "none of the {pairs:.0f} pairs of cameras has a pose that explains what both saw at once: wrong things, wrong lenses, or "
        "clocks that are farther apart than what is tried",
    )

    RANGE_TOO_WIDE = "range-too-wide", "the disparity range is too wide"
    NO_DENSE_MATCHES = "no-dense-matches", "almost nothing matches densely"
    NO_PAIR_DEPTH = "no-pair-depth", "no pair gave depth for this view"
    NO_USEFUL_ANGLE = "no-useful-angle", "no other view sees the scene from a useful angle"
    NO_DEPTH = "no-depth", "no view has depth"
    NO_SUPPORTED_POINT = "no-supported-point", "no point is probable enough and supported by {min_consistent_pairs:.0f} pairs"


class NoResult(AttributeError, ValueError):
    """A part of a result was asked for, and there is none; the message says why."""


@dataclass(frozen=True)
class Rejected:
    """A stage ran, and found nothing usable.

    A user's own function may give the reason in its own words; the code is then "other".
    """

    why: Reason | str
    figures: Mapping[str, float] = field(default_factory=dict)
    """The numbers behind the reason; the message names some of them."""
    words: str = ""
    """The message, if it was made by another stage, which knew the figures."""

    def __post_init__(self) -> None:
        _ = self.reason  # a missing figure raises KeyError here, where it was forgotten, not where the message is shown

    if not TYPE_CHECKING:  # a type checker is to find this before

        def __getattr__(self, name: str) -> None:
            """Raises NoResult with the reason: somebody goes on as if there were a result."""
            if name.startswith("_"):  # what Python and notebooks look for
                raise AttributeError(name)
            raise NoResult(f"there is no {name!r}, since nothing usable was found: {self.reason}")

    @property
    def code(self) -> str:
        """One of `Reason`, or "other"."""
        return self.why.value if isinstance(self.why, Reason) else "other"

    @property
    def reason(self) -> str:
        """The message.  Raises KeyError if a figure that it needs is missing."""
        if self.words or not isinstance(self.why, Reason):
            return self.words or self.why
        return self.why.template.format_map(self.figures).replace("%", " %")


Result = TypeVar("Result")


def usable(result: Result | Rejected) -> Result:
    """The result itself, for programs that cannot go on without it.  Raises ValueError with the reason if it is `Rejected`."""
    if isinstance(result, Rejected):
        raise ValueError(result.reason)
    return result
