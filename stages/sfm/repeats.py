"""Does a scene look the same from other sides, or along a row?  Then wrong pairs may close all loops.

A pair's rival (`twoview.ambiguity`) tells, by the angle between its rotation and the accepted one.  What looks the same from
another side gives one that is turned by a part of a full turn; what repeats along a row gives the same rotation with another
step.  One pair may have such a rival by chance, and few pairs of a scene that does repeat see what tells; the site's pairs
together decide.

Three pairs that are each as distinct as right ones and yet contradict each other by a part of a full turn tell the same at once.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from math import isfinite, log

from ..core.rotations import angle_between_deg
from ..reasons import Reason
from ..twoview.ambiguity import MUCH_TURNED, SAME_ROTATION_DEG, TURNED_DEG
from ..twoview.pair_score import DISTINCT_CELLS
from ..types import Geometry, Pair

PARTS_DEG = (180.0, 120.0, 90.0, 60.0)
"""Of a full turn: buildings with two, three, four and six equal sides."""
PART_WITHIN_DEG = 2.0
ROW_SHARE, ROW_INLIERS = 0.2, 20
"""Of the accepted inliers, and matches, that a rival of the same rotation needs."""


class AmbiguityKind(Enum):
    """What the rival of a pair looks like."""

    NONE = "none"
    TURNED = "turned"
    SIDE = "side"
    """Turned by a part of a full turn."""
    ROW = "row"
    """Not turned at all."""


@dataclass(frozen=True)
class Shares:
    """Of the pairs of a scene that have a rival of each kind."""

    turned: float
    side: float
    row: float

    def log_odds(self, other: Shares, kind: AmbiguityKind) -> float:
        """For this scene against the other, of one pair."""
        return log(self._of(kind) / other._of(kind))

    def _of(self, kind: AmbiguityKind) -> float:
        none = 1 - self.turned - self.side - self.row
        return {
            AmbiguityKind.NONE: none,
            AmbiguityKind.TURNED: self.turned,
            AmbiguityKind.SIDE: self.side,
            AmbiguityKind.ROW: self.row,
        }[kind]


FROM_OTHER_SIDES, IN_A_ROW = Shares(turned=0.3, side=0.2, row=0.01), Shares(turned=0.1, side=0.01, row=0.5)
"""Scenes that repeat; by what a pair can see, since there is one family of each to measure: only cameras that look around a
corner see another side, and any two of a row see another house."""
P_REPEATS = 0.2
"""Of a site to be the one or the other."""


def ambiguity_kind(geometry: Geometry) -> AmbiguityKind | None:
    """The kind of a pair's rival, None where nobody looked for one."""
    turned = geometry.rival_turned_deg
    if not isfinite(turned):
        return None
    share = geometry.rival_elsewhere / max(geometry.inliers, 1)
    if share >= MUCH_TURNED and _part_of_a_turn(turned):
        return AmbiguityKind.SIDE
    if share >= ROW_SHARE and geometry.rival_elsewhere >= ROW_INLIERS and turned < SAME_ROTATION_DEG:
        return AmbiguityKind.ROW
    return AmbiguityKind.TURNED if share >= MUCH_TURNED and turned > TURNED_DEG else AmbiguityKind.NONE


def _part_of_a_turn(degrees: float) -> bool:
    return min(abs(degrees - part) for part in PARTS_DEG) <= PART_WITHIN_DEG


def distinct_copies(posed: Mapping[Pair, Geometry], triangles: Iterable[tuple[str, str, str]]) -> bool:
    """Do pairs, each as distinct as right ones, contradict each other by parts of a full turn around triangles of cameras?

    One of the three is wrong, then, and matches one side of a building with another as well as a right pair matches what it sees.
    By chance a sixth of all rotations are so near to a part of a turn: most that contradict have to be.
    """
    turned = []
    for a, b, c in triangles:
        sides = [posed[pair] for pair in ((a, b), (b, c), (a, c))]
        first, second, direct = (g.cam2_R_cam1 for g in sides)
        if first is None or second is None or direct is None or min(g.distinct_cells for g in sides) < DISTINCT_CELLS:
            continue
        degrees = angle_between_deg(direct, second @ first)
        if degrees > TURNED_DEG:
            turned.append(_part_of_a_turn(degrees))
    return 2 * turned.count(True) > len(turned)


def why_ambiguous(geometries: Iterable[Geometry], usual: Shares) -> Reason | None:
    """In which way a scene repeats, None where it more likely does not; usual: the shares of scenes that don't."""
    kinds = [kind for geometry in geometries if (kind := ambiguity_kind(geometry)) is not None]
    prior = log(P_REPEATS / (1 - P_REPEATS))
    odds = {
        Reason.SAME_FROM_OTHER_SIDES: prior + sum(FROM_OTHER_SIDES.log_odds(usual, kind) for kind in kinds),
        Reason.SAME_ALONG_A_ROW: prior + sum(IN_A_ROW.log_odds(usual, kind) for kind in kinds),
    }
    likely = max(odds, key=lambda reason: odds[reason])
    return likely if odds[likely] > 0 else None
