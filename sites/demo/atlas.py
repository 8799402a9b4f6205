"""All textures of a scene, each with its halvings, in one array that a kernel can look things up in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from wbflow_stages.core.jit import kernel
from wbflow_stages.types import Float32s, Int32s, Uint8s

from .paint import Texture


@dataclass(frozen=True)
class Atlas:
    """All textures and their halvings in one array of bytes."""

    texels: Uint8s
    """(n, 3) uint8."""
    starts: Int32s
    heights: Int32s
    widths: Int32s
    """(textures, levels) int32."""
    texel_m: Float32s
    """(textures,) float32."""


LEVELS = 9


@kernel
def _halve(fine: Uint8s, coarse: Uint8s) -> None:
    """Mean of 2 x 2 texels in linear light (texels hold square roots)."""
    h, w = fine.shape[:2]
    for i in range(coarse.shape[0]):
        for j in range(coarse.shape[1]):
            i2, j2 = min(2 * i + 1, h - 1), min(2 * j + 1, w - 1)
            for c in range(3):
                total = float(fine[2 * i, 2 * j, c]) ** 2 + float(fine[2 * i, j2, c]) ** 2
                total += float(fine[i2, 2 * j, c]) ** 2 + float(fine[i2, j2, c]) ** 2
                coarse[i, j, c] = np.uint8(np.sqrt(0.25 * total) + 0.5)


def build_atlas(textures: tuple[Texture, ...]) -> Atlas:
    """Textures with their pyramids."""
    parts: list[Uint8s] = []
    starts, heights, widths = (np.zeros((len(textures), LEVELS), np.int32) for _ in range(3))
    position = 0
    for t, texture in enumerate(textures):
        pixels = texture.pixels
        for level in range(LEVELS):
            starts[t, level], heights[t, level], widths[t, level] = position, pixels.shape[0], pixels.shape[1]
            parts.append(pixels.reshape(-1, 3))
            position += len(parts[-1])
            coarse = np.empty(((pixels.shape[0] + 1) // 2, (pixels.shape[1] + 1) // 2, 3), np.uint8)
            _halve(pixels, coarse)
            pixels = coarse
    texel_m = np.array([t.texel_m for t in textures], np.float32)
    return Atlas(np.concatenate(parts), starts, heights, widths, texel_m)
