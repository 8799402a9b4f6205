"""The rivals of a site's pairs reveal a scene that repeats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from wbflow_stages.contracts.reasons import Reason
from wbflow_stages.sfm.loops import WITHOUT_REPETITION, AmbiguityKind, ambiguity_kind, why_ambiguous
from wbflow_stages.types import Geometry, View

NOTHING = np.zeros((0, 2))
PLAIN = Geometry(
    F=np.eye(3), x1=NOTHING, x2=NOTHING, i1=None, i2=None, probability=np.zeros(0, np.float32), view1=View(1, 1),
    view2=View(1, 1), cam2_R_cam1=None, cam2_t_cam1=None, matches=200, inliers=200, model="E", epipolar_px=0.3, angle_deg=20.0,
    homography_share=0.3, score=5.0, good_probability=0.99, rival_turned_deg=0.0,
)  # fmt: skip


def pair_with_rival(share: float, turned_deg: float) -> Geometry:
    return replace(PLAIN, rival_elsewhere=round(share * PLAIN.inliers), rival_turned_deg=turned_deg)


@pytest.mark.parametrize(
    ("share", "turned_deg", "kind"),
    [
        (0.1, 179.0, AmbiguityKind.SIDE),
        (0.1, 90.8, AmbiguityKind.SIDE),
        (0.1, 75.0, AmbiguityKind.TURNED),
        (0.3, 0.3, AmbiguityKind.ROW),
        (0.1, 0.3, AmbiguityKind.NONE),
        (0.3, 8.0, AmbiguityKind.NONE),
        (0.02, 180.0, AmbiguityKind.NONE),
    ],
)
def test_a_rival_is_classified_by_its_share_and_turn(share: float, turned_deg: float, kind: AmbiguityKind) -> None:
    assert ambiguity_kind(pair_with_rival(share, turned_deg)) is kind


def test_pairs_without_a_search_for_rivals_are_not_classified() -> None:
    bare = replace(PLAIN, rival_turned_deg=float("nan"))
    assert ambiguity_kind(bare) is None
    assert why_ambiguous([bare] * 5, WITHOUT_REPETITION.rivals) is None


def test_one_rival_of_another_side_is_enough_among_few_pairs_but_not_many() -> None:
    plain, side = pair_with_rival(0.02, 60.0), pair_with_rival(0.15, 90.0)
    assert why_ambiguous([side, plain, plain], WITHOUT_REPETITION.rivals) is Reason.SAME_FROM_OTHER_SIDES
    assert why_ambiguous([side] + [plain] * 27, WITHOUT_REPETITION.rivals) is None
    assert why_ambiguous([side] * 6 + [plain] * 20, WITHOUT_REPETITION.rivals) is Reason.SAME_FROM_OTHER_SIDES


def test_a_row_of_identical_houses_is_distinguished_from_identical_sides() -> None:
    plain, shifted = pair_with_rival(0.02, 60.0), pair_with_rival(0.4, 0.1)
    assert why_ambiguous([shifted] * 3 + [plain], WITHOUT_REPETITION.rivals) is Reason.SAME_ALONG_A_ROW
    assert why_ambiguous([plain] * 4, WITHOUT_REPETITION.rivals) is None
