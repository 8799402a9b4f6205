"""The view graph: all views of a site by number, the geometries of their pairs, and which focal lengths to solve.

With the right focal lengths, `K2^T F K1` is an essential matrix, whose two singular values are equal (Mendonca & Cipolla, CVPR
1999).  One pair constrains focal lengths weakly, and not at all if the two axes meet; all pairs of a site constrain them well."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..contracts.reasons import Reason, Rejected
from ..core.cameras import camera_of
from ..core.rotations import angle_between_deg
from ..twoview.robust import pose_of_fundamental
from ..types import Camera, Float64s, Geometry, Pair, View
from .incremental import Model, grow
from .loops import WITHOUT_REPETITION, LoopCheck, LoopStatistics, check_loops
from .rigs import first_views, rotation_between
from .rotation_averaging import average_rotations, components
from .tracks import Edge, build_tracks

_AMBIGUOUS = (Reason.AMBIGUOUS, Reason.SAME_FROM_OTHER_SIDES, Reason.SAME_ALONG_A_ROW)
"""Reasons for which a pair counts as ambiguous."""
_CERTAIN = 2.0
"""Spanning tree weight of views that one camera ties together: above any probability."""
NARROW = 0.35
"""Shortest focal length tried, in image widths: a field of view of 110 degrees."""
WIDE = 6.0
"""Longest focal length tried, in image widths: a field of view of 9.5 degrees."""
GRID = 143
"""Number of focal lengths tried, evenly in their logarithm: 2 % apart."""
FIRST = 1.0
"""Initial focal length of an unknown lens, in image widths."""
GUESS_SIGMA = 0.2
"""Relative standard deviation of a guessed focal length (from a field of view or EXIF)."""
GUESS_WEIGHT = 0.05
"""Weight of a guess against the votes of the pairs, each at most the root of its inliers times `MOST_UNEQUAL`."""
MOST_UNEQUAL = 0.1
"""Largest relative difference of singular values that counts: beyond it a pair is wrong, and says nothing of the lens."""
SWEEPS = 5
"""Most rounds over all lenses: the best focal length of one depends on the other's of a pair."""
ONE_LENS = 0.1
"""Views share a lens if the focal lengths from their own pairs differ from the common one by less than this share (median)."""


@dataclass(frozen=True)
class ViewGraph:
    """All views by number, their lenses as far as known, and the geometries of their pairs."""

    names: tuple[str, ...]
    views: tuple[View, ...]
    lenses: Lenses
    geometries: Mapping[Edge, Geometry]

    @classmethod
    def of(cls, views: Mapping[str, View], geometries: Mapping[Pair, Geometry]) -> ViewGraph:
        """The graph of the views by id, with the pairs whose views are both among them and whose lenses can be guessed."""
        names = tuple(views)
        number = {name: k for k, name in enumerate(names)}
        edges = {}
        for (a, b), geometry in geometries.items():
            if a in number and b in number:
                edges[number[a], number[b]] = geometry
        lenses = guess_lenses(tuple(views.values()), edges)
        return cls(names, tuple(views.values()), lenses, relative_rotations(edges, lenses))

    @cached_property
    def fixed_rotations(self) -> dict[Edge, Float64s]:
        """Rotations from the first view of each camera to its other views."""
        first_of = first_views(dict(enumerate(self.views)))
        rotations = {}
        for first, view in sorted((first, view) for view, first in first_of.items()):
            if first != view:
                rotations[first, view] = rotation_between(self.views[first].lens, self.views[view].lens)
        return rotations

    def ids(self, edge: Edge) -> Pair:
        """The ids of the two views of a pair."""
        return self.names[edge[0]], self.names[edge[1]]

    def consistent(
        self, tolerance_deg: float, statistics: LoopStatistics = WITHOUT_REPETITION
    ) -> tuple[dict[Edge, Geometry], dict[Edge, Rejected]]:
        """The pairs that the site as a whole supports and whose rotations agree, and why the others are left out."""
        # 1. Loops of three cameras judge all pairs together.
        checks = self._loop_checks(statistics)
        dropped = {edge: check.rejected for edge, check in checks.items() if check.rejected is not None}

        # 2. Average the rotations of the others, and those between views of one camera, which are exact.
        rotations: dict[Edge, Float64s] = {}
        for edge, geometry in self.geometries.items():
            if geometry.cam2_R_cam1 is not None and edge not in dropped:
                rotations[edge] = geometry.cam2_R_cam1
        weights = {edge: checks[edge].good_probability for edge in rotations}
        weights |= dict.fromkeys(self.fixed_rotations, _CERTAIN)
        averaged = average_rotations(rotations | self.fixed_rotations if rotations else {}, weights)

        # 3. Drop the pairs that the average contradicts.
        accepted = {}
        for edge, R in rotations.items():
            error_deg = angle_between_deg(R, averaged[edge[1]] @ averaged[edge[0]].T)
            if error_deg <= tolerance_deg:
                accepted[edge] = self.geometries[edge]
            else:
                dropped[edge] = Rejected(Reason.CONTRADICTS_ROTATIONS, {"off_deg": error_deg})
        return accepted, dropped

    def _loop_checks(self, statistics: LoopStatistics) -> dict[Edge, LoopCheck]:
        """The loop check of each pair; it works on ids, since these name its findings."""
        uncertainty_deg = rotation_uncertainty_deg(self.geometries, self.lenses)
        uncertain = {self.ids(edge): degrees for edge, degrees in uncertainty_deg.items()}
        geometries = {self.ids(edge): geometry for edge, geometry in self.geometries.items()}
        checks = check_loops(geometries, uncertain, statistics)
        return {edge: checks[self.ids(edge)] for edge in self.geometries}

    def models(self, accepted: Mapping[Edge, Geometry], known: Mapping[int, Camera]) -> list[Model]:
        """A model of every connected part of the accepted pairs, largest first; known cameras stay fixed."""
        grown = []
        fixed = list(self.fixed_rotations)
        matched = {view for edge in accepted for view in edge}
        # a part without any pair holds only views of one camera
        waiting = [part for part in components([*accepted, *fixed]) if not matched.isdisjoint(part)]
        while waiting:
            part = waiting.pop(0)
            edges = {edge: geometry for edge, geometry in accepted.items() if edge[0] in part and edge[1] in part}
            model = self._grown(part, edges, known)
            if model is None:
                continue
            grown.append(model)
            # what did not fit to this model may hold together on its own
            unplaced = set(part) - set(model.cameras)
            waiting += components([edge for edge in (*edges, *fixed) if unplaced.issuperset(edge)])
        return sorted(grown, key=lambda model: (-len(model.cameras), min(model.cameras)))

    def _grown(self, part: list[int], edges: Mapping[Edge, Geometry], known: Mapping[int, Camera]) -> Model | None:
        """The model of one connected part; None if not even two of its views can be placed."""
        unposed = {view: camera_of(self.views[view], self.lenses.K[view], np.eye(3), np.zeros(3)) for view in part}
        known_here = {view: known[view] for view in part if view in known}
        tracks = build_tracks(edges, len(self.names))
        return grow(unposed, tracks, edges, lenses=self.lenses.solved, known=known_here)

    def why_nothing(self, accepted: Mapping[Edge, Geometry], dropped: Mapping[Edge, Rejected]) -> Rejected:
        """Why not even two views can be placed: the reason that most pairs share."""
        figures = {"cameras": float(len(self.views)), "pairs": float(len(self.geometries))}
        if not self.geometries:
            return Rejected(Reason.NO_GEOMETRY, figures)
        if accepted:
            return Rejected(Reason.TOO_FEW_POINTS, figures)
        reasons = [rejection.why for rejection in dropped.values()]
        figures["unconfirmed"] = float(reasons.count(Reason.UNCONFIRMED))
        figures["ambiguous"] = float(sum(reason in _AMBIGUOUS for reason in reasons))
        if figures["ambiguous"] > 0.5 * len(reasons):
            return Rejected(Reason.NOTHING_DISTINCT, figures)
        if figures["unconfirmed"] > 0.5 * len(reasons):
            return Rejected(Reason.NOTHING_CONFIRMED, figures)
        if reasons.count(Reason.NOT_BELIEVED) > 0.5 * len(reasons):
            return Rejected(Reason.NOTHING_BELIEVED, figures)
        return Rejected(Reason.PAIRS_CONTRADICT, figures)


@dataclass(frozen=True)
class Lenses:
    """Lenses of the views: known, guessed, or to be solved."""

    K: Mapping[int, Float64s]
    """Intrinsics of the views that have some, known or guessed."""
    solved: Mapping[int, int]
    """Views whose focal length is to be solved, each with the number of its lens, which views may share."""


def guess_lenses(views: tuple[View, ...], geometries: Mapping[Edge, Geometry]) -> Lenses:
    """Intrinsics of all views: the known ones, or with the focal length that best agrees with the fundamental matrices.

    Views of one size and one guess share a lens, unless their own pairs yield clearly different focal lengths.  The principal
    point is that of the guess, or the image centre.
    """
    known = {k: view.K for k, view in enumerate(views) if view.K is not None and view.focal_known}

    # 1. Assume that views of one size and one guess share a lens, named after the first of them.
    groups = _alike_views(views, geometries, known)
    group_of: dict[int, int] = {}
    for members in groups:
        group_of |= dict.fromkeys(members, members[0])
    shared_focal = _vote_focals(views, geometries, known, group_of)

    # 2. Let each view vote on its own, and split the groups whose views disagree.
    each_alone = {k: k for k in group_of}
    own_focal = _vote_focals(views, geometries, known, each_alone, shared_focal)
    K = dict(known)
    lenses: dict[int, int] = {}
    for members in groups:
        log_ratios = np.abs(np.log([own_focal[k] / shared_focal[k] for k in members]))
        if np.median(log_ratios) < ONE_LENS:
            for k in members:
                lenses[k] = members[0]
                K[k] = _centred_K(views[k], shared_focal[k])
        else:
            for k in members:
                lenses[k] = k
                K[k] = _centred_K(views[k], own_focal[k])
    return Lenses(dict(sorted(K.items())), lenses)


def _alike_views(views: tuple[View, ...], geometries: Mapping[Edge, Geometry], known: Mapping[int, Float64s]) -> list[list[int]]:
    """Groups of the views that are in a pair and have no known lens: those of one size and one guess, in their order."""
    matched = {k for edge in geometries for k in edge}
    groups: dict[tuple[int, int, float], list[int]] = {}
    for k, view in enumerate(views):
        if k in known or k not in matched:
            continue
        # guesses within 1 % are equal
        guess = 0.0 if view.K is None else round(float(np.log(view.K[0, 0])), 2)
        groups.setdefault((view.width, view.height, guess), []).append(k)
    return list(groups.values())


def _vote_focals(
    views: tuple[View, ...],
    geometries: Mapping[Edge, Geometry],
    known: Mapping[int, Float64s],
    lenses: Mapping[int, int],
    start: Mapping[int, float] | None = None,
) -> dict[int, float]:
    """Focal length (pixels) of each view in `lenses`: the grid value with the lowest total cost of its pairs, bounded per pair.

    The cost of a pair is the relative difference of its essential matrix's two singular values.  Repeated until none changes.
    """
    focal: dict[int, float] = {}
    for k in lenses:
        K = views[k].K
        if start is not None:
            focal[k] = start[k]
        elif K is not None:
            focal[k] = float(K[0, 0])
        else:
            focal[k] = FIRST * views[k].width
    for _ in range(SWEEPS):
        previous = dict(focal)
        for lens in sorted(set(lenses.values())):
            members = [k for k in lenses if lenses[k] == lens]
            grid = np.geomspace(NARROW, WIDE, GRID) * views[lens].width
            cost = _cost_of_guess(views[lens], grid)
            for (i, j), geometry in geometries.items():
                if i not in members and j not in members:
                    continue
                # either view has the whole grid of focal lengths, or the one that it has at present: shapes (n or 1, 3, 3)
                K1 = _candidates(views[i], grid if i in members else None, known.get(i), focal.get(i))
                K2 = _candidates(views[j], grid if j in members else None, known.get(j), focal.get(j))
                singular_values = np.linalg.svd(np.swapaxes(K2, 1, 2) @ geometry.F @ K1, compute_uv=False)
                # 0 for an essential matrix, whose two singular values are equal, up to 1
                inequality = 1 - singular_values[:, 1] / singular_values[:, 0]
                cost = cost + np.sqrt(geometry.inliers) * np.minimum(inequality, MOST_UNEQUAL)
            # on the grid only: two rounds that agree are equal to the bit, which ends the sweeps
            best = float(grid[np.argmin(cost)])
            focal.update(dict.fromkeys(members, best))
        if focal == previous:
            break
    return focal


def _cost_of_guess(view: View, grid: Float64s) -> Float64s:
    """(n,) cost of each focal length of the grid (n,) for its distance from a view's guess; 0 without a guess."""
    if view.K is None:
        return np.zeros(len(grid))
    deviations = np.log(grid / view.K[0, 0]) / GUESS_SIGMA
    return np.asarray(GUESS_WEIGHT * deviations**2, dtype=np.float64)


def _candidates(view: View, grid: Float64s | None, known: Float64s | None, focal: float | None) -> Float64s:
    """(n, 3, 3) intrinsics for each focal length of the grid, or (1, 3, 3) the known or current ones."""
    if grid is not None:
        return np.array([_centred_K(view, f) for f in grid])
    if known is not None:
        return known[None]
    assert focal is not None
    return _centred_K(view, focal)[None]


def _centred_K(view: View, focal: float) -> Float64s:
    """(3, 3) intrinsics with this focal length in pixels; the principal point is that of the guess, or the image centre."""
    if view.K is None:
        cx = 0.5 * (view.width - 1)
        cy = 0.5 * (view.height - 1)
    else:
        cx = view.K[0, 2]
        cy = view.K[1, 2]
    return np.array([[focal, 0.0, cx], [0.0, focal, cy], [0.0, 0.0, 1.0]])


def relative_rotations(geometries: Mapping[Edge, Geometry], lenses: Lenses) -> dict[Edge, Geometry]:
    """The geometries of pairs whose lenses are known or guessed, with relative poses for these lenses."""
    posed = {}
    for (i, j), geometry in geometries.items():
        if i not in lenses.K or j not in lenses.K:
            continue
        if i in lenses.solved or j in lenses.solved:
            # the pose that the geometry has, if any, is for other focal lengths
            view1 = replace(geometry.view1, K=lenses.K[i])
            view2 = replace(geometry.view2, K=lenses.K[j])
            pose = pose_of_fundamental(geometry.F, geometry.x1, geometry.x2, view1, view2)
            if pose is None:
                continue
            geometry = replace(geometry, cam2_R_cam1=pose[0], cam2_t_cam1=pose[1])
        posed[i, j] = geometry
    return posed


def rotation_uncertainty_deg(geometries: Mapping[Edge, Geometry], lenses: Lenses) -> dict[Edge, float]:
    """By how much (degrees) the rotation of each pair changes if the guessed focal lengths grow by `GUESS_SIGMA`."""
    longer = np.diag([1 + GUESS_SIGMA, 1 + GUESS_SIGMA, 1.0])
    longer_K = dict(lenses.K)
    for k in lenses.solved:
        longer_K[k] = lenses.K[k] @ longer
    guessed = {edge: g for edge, g in geometries.items() if not lenses.solved.keys().isdisjoint(edge)}
    changes = {}
    for edge, changed in relative_rotations(guessed, replace(lenses, K=longer_K)).items():
        R = geometries[edge].cam2_R_cam1
        if R is not None and changed.cam2_R_cam1 is not None:
            changes[edge] = angle_between_deg(changed.cam2_R_cam1, R)
    return changes
