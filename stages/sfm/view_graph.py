"""The view graph: all views of a site by number, what is known of their lenses, and the geometries of their pairs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from ..core.rotations import angle_between_deg
from ..reasons import Reason, Rejected
from ..types import Camera, Float64s, Geometry, Pair, View
from .focal import Lenses, guess_lenses, relative_rotations, unsure_deg
from .incremental import Model, grow
from .loops import USUAL, Habits, check_loops
from .rigs import between, rigs_of
from .rotation_averaging import average_rotations, components
from .tracks import Edge, build_tracks

_AMBIGUOUS = (Reason.AMBIGUOUS, Reason.SAME_FROM_OTHER_SIDES, Reason.SAME_ALONG_A_ROW)


_CERTAIN = 2.0
"""What is tied goes before all that is only probable."""


@dataclass(frozen=True)
class ViewGraph:
    """All views by number, what is known of their lenses, and the geometries of their pairs."""

    names: tuple[str, ...]
    views: tuple[View, ...]
    lenses: Lenses
    geometries: Mapping[Edge, Geometry]
    rotations: Mapping[Edge, Float64s]

    @classmethod
    def of(cls, views: Mapping[str, View], geometries: Mapping[Pair, Geometry]) -> ViewGraph:
        names = tuple(views)
        number = {name: k for k, name in enumerate(names)}
        edges = {(number[a], number[b]): geometry for (a, b), geometry in geometries.items() if a in number and b in number}
        lenses = guess_lenses(tuple(views.values()), edges)
        edges = relative_rotations(edges, lenses)
        rotations = {edge: g.cam2_R_cam1 for edge, g in edges.items() if g.cam2_R_cam1 is not None}
        return cls(names, tuple(views.values()), lenses, edges, rotations)

    @cached_property
    def tied(self) -> dict[Edge, Float64s]:
        """How views of one camera are turned against its first."""
        views = dict(enumerate(self.views))
        return {(a, b): between(views[a].lens, views[b].lens) for a, (_, *others) in rigs_of(views).items() for b in others}

    def pair(self, edge: Edge) -> str:
        return f"{self.names[edge[0]]}--{self.names[edge[1]]}"

    def consistent(self, tolerance_deg: float, usual: Habits = USUAL) -> tuple[list[Edge], dict[Edge, Rejected]]:
        """The pairs that the site as a whole believes and whose rotations agree, and why the others are left out."""
        unsure = {(self.names[i], self.names[j]): degrees for (i, j), degrees in unsure_deg(self.geometries, self.lenses).items()}
        named = {(self.names[i], self.names[j]): geometry for (i, j), geometry in self.geometries.items()}
        judged = check_loops(named, unsure, usual)
        checks = {edge: judged[self.names[edge[0]], self.names[edge[1]]] for edge in self.geometries}
        dropped = {edge: check.rejected for edge, check in checks.items() if check.rejected is not None}
        believed = {edge: R for edge, R in self.rotations.items() if edge not in dropped}
        weights = {edge: checks[edge].good_probability for edge in believed} | dict.fromkeys(self.tied, _CERTAIN)
        averaged = average_rotations(believed | self.tied if believed else {}, weights)
        trusted = []
        for edge, R in believed.items():
            off_deg = angle_between_deg(R, averaged[edge[1]] @ averaged[edge[0]].T)
            if off_deg <= tolerance_deg:
                trusted.append(edge)
            else:
                dropped[edge] = Rejected(Reason.CONTRADICTS_ROTATIONS, {"off_deg": off_deg})
        return trusted, dropped

    def models(self, trusted: list[Edge], known: Mapping[int, Camera]) -> list[Model]:
        """A model of every part that hangs together, largest first; known cameras stay."""
        found = []
        tied = list(self.tied)
        waiting = [part for part in components([*trusted, *tied], _views([*trusted, *tied])) if {*part} & {*_views(trusted)}]
        while waiting:
            part = waiting.pop(0)
            edges = {edge: self.geometries[edge] for edge in trusted if edge[0] in part and edge[1] in part}
            tracks = build_tracks(edges, len(self.names))
            bare = {view: self.lenses.camera(view) for view in part}
            there = {view: known[view] for view in part if view in known}
            model = grow(bare, tracks, edges, lenses=self.lenses.solved, known=there)
            if model is None:
                continue
            found.append(model)
            left = [view for view in part if view not in model.cameras]
            theirs = [e for e in (*edges, *tied) if e[0] in left and e[1] in left]
            waiting += [p for p in components(theirs, left) if len(p) > 1]
        return sorted(found, key=lambda model: (-len(model.cameras), min(model.cameras)))

    def why_nothing(self, trusted: list[Edge], dropped: Mapping[Edge, Rejected]) -> Rejected:
        """Why not even two views can be placed: of the reasons of the pairs, the one that most have."""
        figures = {"cameras": float(len(self.views)), "pairs": float(len(self.geometries))}
        if not self.geometries:
            return Rejected(Reason.NO_GEOMETRY, figures)
        if trusted:
            return Rejected(Reason.TOO_FEW_POINTS, figures)
        codes = [why.why for why in dropped.values()]
        figures["unconfirmed"] = float(codes.count(Reason.UNCONFIRMED))
        figures["ambiguous"] = float(sum(code in _AMBIGUOUS for code in codes))
        if figures["ambiguous"] > 0.5 * len(codes):
            return Rejected(Reason.NOTHING_DISTINCT, figures)
        if figures["unconfirmed"] > 0.5 * len(codes):
            return Rejected(Reason.NOTHING_CONFIRMED, figures)
        nobody = codes.count(Reason.NOT_BELIEVED) > 0.5 * len(codes)
        return Rejected(Reason.NOTHING_BELIEVED if nobody else Reason.PAIRS_CONTRADICT, figures)


def _views(edges: list[Edge]) -> list[int]:
    return sorted({view for edge in edges for view in edge})
