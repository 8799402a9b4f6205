"""Poses from observations of things (`observed_poses`) among the stated ones: evidence for whatever needs to know the cameras."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from ..core.cameras import camera_id
from ..types import Geometry, ObservedPoses, Pair, Placement, Poses, View

LEAST_PROBABILITY = 0.98
"""Smallest probability of a pair that may contradict or correct two observed poses: their cameras have rarely (1 of 50) been
moved since."""


@dataclass(frozen=True)
class KnownPlaces:
    """What is known of the cameras' places before they are matched: stated, completed by what observations have determined."""

    views: Mapping[str, View]
    """By id of a camera, or of a view of a wide camera; a lens that was solved with the poses counts as known."""
    placements: Mapping[str, Placement]
    """By the same ids."""
    observed: frozenset[str] = frozenset()
    """Those whose placement comes from observations."""
    reasons: Mapping[str, str] = field(default_factory=dict)
    """Why observations could not place others."""
    scale: str = ""
    """Source of the scale of observed placements."""

    def credible(self, geometries: Mapping[Pair, Geometry]) -> dict[Pair, Geometry]:
        """The pairs, of which those of two observed cameras count as improbable unless they are very probable.

        Hundreds of moments of a thing place such cameras, so that they have hardly ever another pose than the observed one, and
        then because they were moved since: a few matches that say so are look-alikes.
        """
        credible = dict(geometries)
        for pair, geometry in geometries.items():
            if self.observed.issuperset(pair) and geometry.good_probability < LEAST_PROBABILITY:
                credible[pair] = replace(geometry, good_probability=0.0)
        return credible

    def with_sources(self, poses: Poses) -> Poses:
        """The poses, with sources and reasons that tell observed placements from stated ones."""
        sources = dict(poses.sources)
        for name in self.observed & poses.cameras.keys():
            if sources.get(name, "stated") in {"stated", "refined"}:
                sources[name] = "observed"
        unsolved = dict(poses.unsolved)
        for name in self.reasons.keys() & poses.unsolved.keys():
            unsolved[name] = f"{self.reasons[name]}; {poses.unsolved[name]}"
        scale = poses.scale
        if self.observed and poses.source == "calibration":
            scale = self.scale
        return replace(poses, sources=sources, unsolved=unsolved, scale=scale)


def with_observed(views: Mapping[str, View], placements: Mapping[str, Placement], observed: ObservedPoses | None) -> KnownPlaces:
    """The stated placements, completed by those that observations have determined.

    An exact stated pose is kept: the observations were solved in its frame.  Any other statement has only placed that frame, and
    is less exact than what they determine, which replaces it.

    Parameters
    ----------
    views, placements : by id of a camera, or of a view of a wide camera.
    observed : poses by id of a camera; None if there are none.
    """
    if observed is None:
        return KnownPlaces(views, placements)
    known_views = dict(views)
    known_placements = dict(placements)
    placed = set()
    reasons = {}
    for name, view in views.items():
        camera = camera_id(name, view)
        figures = observed.cameras.get(camera)
        if figures is not None and figures.reason:
            reasons[name] = figures.reason
        placement = observed.placements.get(camera)
        if placement is None or is_exact(placements.get(name)):
            continue
        # a view of a wide camera is turned against the camera itself
        if view.lens is not None and view.lens.turn is not None and placement.R is not None:
            placement = replace(placement, R=view.lens.turn @ placement.R)
        known_placements[name] = placement
        placed.add(name)
        factor = observed.focal_scales.get(camera)
        if factor is not None and view.K is not None:
            K = view.K.copy()
            K[:2, :2] *= factor
            known_views[name] = replace(view, K=K, focal_known=True)
    return KnownPlaces(known_views, known_placements, frozenset(placed), reasons, observed.scale)


def is_exact(placement: Placement | None) -> bool:
    """Is a pose stated completely and without standard deviations?"""
    if placement is None or placement.R is None or placement.C is None:
        return False
    return placement.sigma_m == 0 and placement.sigma_deg == 0
