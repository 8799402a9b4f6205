"""Surfaces with weak texture: white plaster, wet asphalt, snow."""

from __future__ import annotations

import numpy as np

from ..render.paint import Colour, Rng, Texture, cracks, encode, fractal_noise, mix, shape_of

SURFACES = {
    "standard": "as the scene has them",
    "weak": "white plaster on the walls, wet asphalt on the western half of the ground, snow on the eastern",
}
"""Description of each kind of surfaces."""

_GLOSS = 0.7
"""Gloss of asphalt under a film of water, below 1 because stones protrude from it."""


def check_surfaces(surfaces: str, scene: str) -> None:
    """Raise ValueError for surfaces that are not in `SURFACES`, or that the scene does not have."""
    if surfaces not in SURFACES:
        raise ValueError(f"surfaces are {', '.join(SURFACES)}, not {surfaces!r}")
    if surfaces != "standard" and scene != "yard":
        raise ValueError(f"the yard has {surfaces} surfaces, {scene} has not")


def white_plaster(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Paint freshly whitened, even plaster: one per cent of contrast, a few hair cracks."""
    image = _nearly_even(rng, (width_m, height_m), texel_m, (0.80, 0.79, 0.76), broad=0.012, fine=0.006, fine_m=0.05)
    # one for each five metres: too few to match by
    hair = cracks(rng, image.shape[:2], texel_m, count=int(width_m / 5), length_m=1.5)
    mix(image, (0.45, 0.43, 0.40), 0.4 * hair)
    return encode(image, texel_m)


def wet_asphalt(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Paint wet asphalt: dark, with stones of a few centimetres that hardly differ, and a gloss that mirrors the sky."""
    image = _nearly_even(rng, (width_m, height_m), texel_m, (0.045, 0.045, 0.048), broad=0.06, fine=0.08, fine_m=0.04)
    seams = cracks(rng, image.shape[:2], texel_m, count=int(width_m * height_m / 60), length_m=3.0)
    mix(image, (0.02, 0.02, 0.02), 0.7 * seams)
    return encode(image, texel_m, _GLOSS)


def snow(rng: Rng, width_m: float, height_m: float, texel_m: float) -> Texture:
    """Paint fresh snow: soft waves with one per cent of contrast."""
    image = _nearly_even(rng, (width_m, height_m), texel_m, (0.86, 0.88, 0.90), broad=0.015, fine=0.010, fine_m=0.12)
    return encode(image, texel_m)


def _nearly_even(
    rng: Rng, size_m: tuple[float, float], texel_m: float, colour: Colour, *, broad: float, fine: float, fine_m: float
) -> np.ndarray:
    """Return (h, w, 3) of one colour with relative deviations: `broad` over metres, `fine` over up to `fine_m` metres."""
    shape = shape_of(*size_m, texel_m)
    # contrasts of a per cent are near the noise of a sensor: matching has to live with little more
    tone = 1 + broad * fractal_noise(rng, shape, texel_m, 3.0) + fine * fractal_noise(rng, shape, texel_m, fine_m, octaves=2)
    return np.asarray(tone[..., None] * np.asarray(colour, np.float32), np.float32)
