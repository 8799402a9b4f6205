"""Models of networks as ONNX files, run by ONNX Runtime on one thread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

import cv2
import numpy as np

from ..core.luminance import grey_levels
from ..types import Capture, Float32s, Uint8s


def onnx_session(model: Capture) -> Any:
    """A model, ready to run.

    Raises ValueError, with the file's name, if it is not an ONNX model, and ModuleNotFoundError without ONNX Runtime.
    """
    return _session(model.name, model.data.tobytes())


@lru_cache(maxsize=2)
def _session(name: str, model: bytes) -> Any:
    """The model of a file of this name.  It uses one thread, so that every machine finds the same."""
    try:
        import onnxruntime  # imported here: most sites work without it
    except ModuleNotFoundError:
        raise ModuleNotFoundError(f"{name} needs ONNX Runtime: pip install 'wbflow[onnx]'") from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.enable_cpu_mem_arena = False  # memory of one image is not kept for the next
    options.log_severity_level = 4  # nothing but fatal errors: the message of the exception says the rest
    try:
        return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # its exceptions have no base class of their own
        needed = "give the file that the model was exported to, whole"
        raise ValueError(f"{name}: ONNX Runtime cannot read it: {_shortened(error)}: {needed}") from None


def run(name: str, session: Any, outputs: Sequence[str], inputs: Mapping[str, Any]) -> list[Any]:
    """Run a model; returns the outputs in order.  Raises ValueError, with the file's name, if it cannot be run.

    Parameters
    ----------
    name : the file's name.
    session : the model.
    outputs : names of the outputs that are wanted.
    inputs : the inputs by name.
    """
    try:
        results: list[Any] = session.run([*outputs], dict(inputs))
    except Exception as error:  # as above
        raise ValueError(f"{name}: ONNX Runtime cannot run it: {_shortened(error)}") from None
    return results


def _shortened(error: Exception) -> str:
    """The end of an exception's text, on one line: it begins with places in ONNX Runtime's own code."""
    return " ".join(str(error).split())[-300:]


def input_shapes(session: Any) -> dict[str, tuple[int, ...]]:
    """Shape of each of the model's inputs by name; 0 where the model leaves a size free (it then has a name, or none)."""
    shapes = {}
    for value in session.get_inputs():
        shapes[value.name] = tuple(size if isinstance(size, int) else 0 for size in value.shape)
    return shapes


def model_input(image: Uint8s, size: tuple[int, int], channels: int) -> Float32s:
    """Input of a model for an image (h, w, 3): (1, c, h, w), 0 to 1, of this width and height."""
    is_smaller = size[0] < image.shape[1] and size[1] < image.shape[0]
    interpolation = cv2.INTER_AREA if is_smaller else cv2.INTER_LINEAR  # areas: nothing aliases
    image = np.asarray(cv2.resize(image, size, interpolation=interpolation), dtype=np.uint8)
    planes = grey_levels(image)[None] if channels == 1 else image.transpose(2, 0, 1)
    return np.ascontiguousarray(planes[None], dtype=np.float32) / np.float32(255)


def interface_of(session: Any) -> str:
    """What a model takes and gives, in words: for the message of a model of another interface."""
    taken = ", ".join(f"{name} {sizes}" for name, sizes in input_shapes(session).items())
    given = ", ".join(value.name for value in session.get_outputs())
    return f"takes {taken} and gives {given}"
