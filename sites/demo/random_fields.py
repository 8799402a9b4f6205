"""Random fields and lettering that the textures are painted with: everything from an explicit generator, in metres."""

from __future__ import annotations

import cv2
import numpy as np

from wbflow_stages.types import Float32s

Rng = np.random.Generator


def smooth_noise(rng: Rng, shape: tuple[int, int], wave_px: tuple[float, float]) -> Float32s:
    """Value noise: (h, w) float32 of about unit variance, correlated over `wave_px` = (along y, along x) pixels."""
    rows, cols = (int(np.ceil(n / max(w, 1.0))) + 2 for n, w in zip(shape, wave_px, strict=True))
    coarse = rng.standard_normal((rows, cols), dtype=np.float32)
    if wave_px[0] <= 1.0 and wave_px[1] <= 1.0:
        return np.ascontiguousarray(coarse[: shape[0], : shape[1]])
    size = (int(np.ceil(cols * max(wave_px[1], 1.0))), int(np.ceil(rows * max(wave_px[0], 1.0))))
    fine = cv2.resize(coarse, size, interpolation=cv2.INTER_LINEAR if max(wave_px) < 3 else cv2.INTER_CUBIC)
    return np.ascontiguousarray(fine[: shape[0], : shape[1]], dtype=np.float32) * np.float32(1.35)


def fractal_noise(
    rng: Rng,
    shape: tuple[int, int],
    texel_m: float,
    longest_m: float,
    *,
    octaves: int = 6,
    gain: float = 0.6,
    stretch: float = 1.0,
) -> Float32s:
    """Sum of octaves of `smooth_noise`, (h, w) float32 of about unit variance; `stretch` > 1 draws it out along y.

    Parameters
    ----------
    rng : Generator
        The source of all that is random in it.
    shape : tuple of int
        Height and width, texels.
    texel_m : float
        Side of a texel, metres.
    longest_m : float
        Wavelength of the coarsest octave, metres.
    octaves : int
        How many, each half as long.
    gain : float
        Weight of an octave over that of the one before.
    stretch : float
        Above 1: drawn out along y.
    """
    total = np.zeros(shape, np.float32)
    power, weight, wave = 0.0, 1.0, longest_m / texel_m
    for _ in range(octaves):
        if wave < 1.0 and power > 0:
            break
        total += np.float32(weight) * smooth_noise(rng, shape, (wave * stretch, wave))
        power += weight**2
        weight *= gain
        wave *= 0.5
    return total * np.float32(1.0 / np.sqrt(power))


def smoothstep(low: float, high: float, x: Float32s) -> Float32s:
    """0 below `low`, 1 above `high`, smooth between."""
    t = np.clip((x - np.float32(low)) / np.float32(high - low), 0, 1)
    return np.asarray(t * t * (3 - 2 * t), dtype=np.float32)


def lettering(
    shape: tuple[int, int], texel_m: float, text: str, x_m: float, y_m: float, height_m: float, *, bold: float = 0.16
) -> Float32s:
    """Coverage (h, w) float32, 0 to 1, of a line of text: top-left corner at (x_m, y_m), capitals `height_m` high.

    Parameters
    ----------
    shape : tuple of int
        Height and width, texels.
    texel_m : float
        Side of a texel, metres.
    text : str
        One line.
    x_m : float
        Of the top left corner.
    y_m : float
        Of the top left corner.
    height_m : float
        Of capitals, metres.
    bold : float
        Stroke width over height.
    """
    cover = np.zeros(shape, np.uint8)
    height = max(height_m / texel_m, 3.0)
    unit = cv2.getTextSize("H", cv2.FONT_HERSHEY_DUPLEX, 4.0, 1)[0][1] / 4.0
    thickness = max(round(height * bold), 1)
    origin = (round(x_m / texel_m), round(y_m / texel_m + height))
    cv2.putText(cover, text, origin, cv2.FONT_HERSHEY_DUPLEX, height / unit, 255, thickness, cv2.LINE_AA)
    return cover.astype(np.float32) / np.float32(255)


def cracks(rng: Rng, shape: tuple[int, int], texel_m: float, *, count: int, length_m: float) -> Float32s:
    """Coverage (h, w) float32 of `count` wandering hairlines of about `length_m`.

    Parameters
    ----------
    rng : Generator
        The source of all that is random in it.
    shape : tuple of int
        Height and width, texels.
    texel_m : float
        Side of a texel, metres.
    count : int
        How many.
    length_m : float
        About so long each, metres.
    """
    cover = np.zeros(shape, np.uint8)
    step = 0.12 / texel_m
    for _ in range(count):
        steps = max(int(length_m * rng.uniform(0.4, 1.6) / 0.12), 3)
        heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.35, steps))
        start = rng.uniform((0, 0), (shape[1], shape[0]))
        path = start + step * np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]), axis=0)
        cv2.polylines(cover, [np.round(path * 16).astype(np.int32)], False, 255, max(round(0.012 / texel_m), 1), cv2.LINE_AA, 4)
    return cover.astype(np.float32) / np.float32(255)


def blobs(rng: Rng, shape: tuple[int, int], texel_m: float, *, count: int, radius_m: float) -> Float32s:
    """Coverage (h, w) float32 of `count` soft-edged irregular spots (oil, lichen, repairs) of about `radius_m`.

    Parameters
    ----------
    rng : Generator
        The source of all that is random in it.
    shape : tuple of int
        Height and width, texels.
    texel_m : float
        Side of a texel, metres.
    count : int
        How many.
    radius_m : float
        About so large each, metres.
    """
    cover = np.zeros(shape, np.uint8)
    angle = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    for _ in range(count):
        radius = radius_m / texel_m * rng.lognormal(0, 0.5)
        outline = radius * (1 + 0.25 * np.convolve(np.tile(rng.standard_normal(24), 3), np.ones(3) / 3, "same")[24:48])
        centre = rng.uniform((0, 0), (shape[1], shape[0]))
        path = centre + np.column_stack([np.cos(angle), np.sin(angle)]) * outline[:, None]
        cv2.fillPoly(cover, [np.round(path * 16).astype(np.int32)], int(rng.integers(90, 255)), cv2.LINE_AA, 4)
    return cover.astype(np.float32) / np.float32(255)
