"""The sky, seen as it is and mirrored in what is wet."""

from __future__ import annotations

import numpy as np

from wbflow_stages.types import Float32s

from .light import Light
from .prepared import PreparedScene, Seen

_HEAD_ON = 0.02
"""What water mirrors of light that falls straight on it."""


def sky_radiance(light: Light, directions: Float32s) -> Float32s:
    """The sky: haze at the horizon, the light's own colour higher up, drifting bands of cloud."""
    up = np.clip(directions[:, 2], 0, 1)[:, None]
    blend = np.sqrt(up)
    x, y = directions[:, 0] / (up[:, 0] + 0.12), directions[:, 1] / (up[:, 0] + 0.12)
    band = np.sin(1.7 * x + 0.6 * y) * np.sin(0.8 * x - 1.9 * y + 1.0) + 0.5 * np.sin(4.1 * x + 2.3 * y) * np.sin(
        3.3 * y - 1.2 * x
    )
    cloud = light.clouds * np.clip(band, 0, 1)[:, None]
    colour = np.asarray(light.haze, np.float32) * (1 - blend) + np.asarray(light.sky, np.float32) * blend
    return np.asarray(colour + cloud * (np.asarray(light.haze, np.float32) - colour * 0.5), dtype=np.float32)


def add_sheen(prepared: PreparedScene, seen: Seen, lifted: Float32s, radiance: Float32s) -> Float32s:
    """Radiance (n, 3) of surfaces that are hit, with the sky mirrored in those that have a gloss.

    What stands before the sky is mirrored as one dark tone, in its right outline: that it moves over the ground with who looks
    is what misleads a matcher.  Schlick's approximation of Fresnel's equations (Computer Graphics Forum 1994).

    Parameters
    ----------
    prepared, seen
        The scene, and what the rays meet.
    lifted
        (n, 3) just off the surfaces.
    radiance
        (n, 3) without sheen; changed in place.
    """
    gloss = np.array([texture.gloss for texture in prepared.scene.textures], np.float32)
    if not gloss.any():
        return radiance
    hit = seen.facet >= 0
    share = gloss[prepared.scene.texture_of[seen.facet[hit]]]
    wet = np.flatnonzero(share > 0)
    rays, facing = seen.directions[hit][wet], seen.facing[wet]
    cosine = np.clip(-np.sum(rays * facing, axis=1, keepdims=True), 0, 1)
    mirrored = (rays + 2 * cosine * facing).astype(np.float32)
    clear = prepared.reaches(lifted[wet], mirrored)[:, None]
    there = clear * sky_radiance(prepared.light, mirrored) + (1 - clear) * np.asarray(prepared.light.ground, np.float32) * 0.5
    part = share[wet, None] * (_HEAD_ON + (1 - _HEAD_ON) * (1 - cosine) ** 5)
    radiance[wet] += part * (there - radiance[wet])
    return radiance
