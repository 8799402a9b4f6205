"""Pictures as the bytes of image files."""

from __future__ import annotations

import cv2
import numpy as np

from wbflow_stages.types import Bools, Uint8s


def jpeg(image: Uint8s, quality: int = 92) -> bytes:
    """JPEG of (h, w, 3) uint8 RGB."""
    return _encoded(".jpg", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, quality])


def png(mask: Bools) -> bytes:
    """PNG of (h, w) bool: white is True."""
    return _encoded(".png", mask.astype(np.uint8) * np.uint8(255), [])


def _encoded(kind: str, image: Uint8s, options: list[int]) -> bytes:
    done, data = cv2.imencode(kind, image, options)
    if not done:
        raise ValueError(f"this picture cannot be written as {kind}: {image.shape}, {image.dtype}")
    return bytes(data.tobytes())
