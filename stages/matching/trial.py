"""Try in a process of its own what may end a process: a model that OpenCV cannot read may take its reader along.

OpenCV 5.0 ends with a segmentation fault while it reads some models as torch exports them (LightGlue's GELU among them).
"""

from __future__ import annotations

import functools
import signal
import subprocess
import sys

_READ = """
import sys, cv2, numpy
try:
    cv2.dnn.readNetFromONNX(numpy.frombuffer(sys.stdin.buffer.read(), numpy.uint8))
except cv2.error:
    pass
"""
_LONGEST_S = 120.0


@functools.lru_cache(maxsize=2)
def why_unreadable(model: bytes) -> str:
    """Why this process had better not read a model; "" where it may."""
    try:
        tried = subprocess.run([sys.executable, "-c", _READ], input=model, capture_output=True, timeout=_LONGEST_S, check=False)
    except subprocess.TimeoutExpired:
        return f"OpenCV has not read it within {_LONGEST_S:.0f} s"
    if tried.returncode >= 0:
        return ""
    return f"OpenCV ends with {signal.Signals(-tried.returncode).name} while it reads it"
