"""Keypoints of a frame: one detector by name, its result as `Features`."""

from __future__ import annotations

import numpy as np

from .contracts.reasons import Reason, Rejected
from .core.methods import bind
from .types import LEARNED, PLAIN, Capture, Features, Frame
from .types.checking import require

DETECTORS = {
    "sift": "wbflow_stages.matching.sift:detect_sift",
    "onnx": "wbflow_stages.matching.learned_keypoints:detect_onnx",
    "sift+onnx": "wbflow_stages.matching.learned_keypoints:detect_both",
}
"""Detectors by name.  A detector takes `frame`, and `model` if it needs a file; its own parameters are keyword-only, with
defaults.  It returns `Features`."""


def detect(
    frame: Frame, *, model: Capture | None = None, detector: str = "sift", min_keypoints: int = 50, **options: object
) -> Features | Rejected:
    """Detect and describe the keypoints of a frame.

    Raises ValueError for an argument of a wrong type, an unknown detector or a missing model, TypeError for a parameter that the
    detector does not have.

    Parameters
    ----------
    frame : the clean frame; keypoints on masked pixels are left out.
    model : the ONNX file of a learned detector: in the site file, `model: PATH` or a name that `wbflow models` lists.  Its
        content, not its path, decides whether keypoints are detected again.
    detector : "sift": SIFT in the frame and in the frame compressed by 2 in x; "onnx": a learned detector, which takes `model`;
        "sift+onnx": both, for views far apart; or a function of your own, `package.module:function`.
    min_keypoints : reject the frame if it has fewer, without those of the compressed view and of the turned picture.
    options : parameters of the detector, see its function.
    """
    require(Frame, frame=frame)
    inputs = {"frame": frame, "model": model}
    features: Features = bind(DETECTORS, detector, inputs, options, Features)()
    count = int(np.isin(features.tilts, (PLAIN, LEARNED)).sum())
    if count < min_keypoints:
        figures = {"keypoints": count, "needed": min_keypoints, "usable_share": float(frame.mask.mean())}
        return Rejected(Reason.TOO_FEW_KEYPOINTS, figures)
    return features
