"""Words that several checks share: reasons that may be long, and lists of names."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from ..records.record import PairRecord

MOST_LETTERS = 200
"""Longest reason in a finding, in characters."""

LEARNED_KEYPOINTS = (
    "learned keypoints match views that are further apart: python -m pip install 'wbflow[onnx]', wbflow models get aliked-n32, "
    "and in the site file  stages: {features: {detector: sift+onnx, model: aliked-n32}}"
)
"""What may help a camera whose views and those of the others have too few matches."""


def shortened(reason: str) -> str:
    """Limit the length of a reason, which may name every file; the record of the camera, pair or task contains all of it."""
    if len(reason) <= MOST_LETTERS:
        return reason
    return f"{reason[: MOST_LETTERS - 3]}..."


def listed(names: Iterable[str]) -> str:
    """Return names separated by commas, shortened if there are many."""
    return shortened(", ".join(names))


def most_common_reason(pairs: Iterable[PairRecord]) -> str:
    """Return the reason that most pairs have for their outcome, shortened; of equally common ones the first.

    pairs: at least one.
    """
    reasons = Counter(str(pair.reason) for pair in pairs)
    (reason, _), *_ = reasons.most_common(1)
    return shortened(reason)
