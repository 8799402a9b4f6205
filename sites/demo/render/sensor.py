"""From radiance to a camera's file: rain, exposure, white balance, vignetting, blur, noise, a burned-in clock, encoding."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

import cv2
import numpy as np

from wbflow_stages.io import rasters
from wbflow_stages.types import Bools, Float32s, Uint8s

from .light import Light
from .paint import Rng


@dataclass(frozen=True)
class Sensor:
    """Parameters of the conversion from light to pixel values."""

    gain: float
    """Exposure factor."""
    balance: tuple[float, float, float]
    """White balance: factors of red, green, blue."""
    full_well: float
    """Electrons at white (fewer: noisier)."""
    read: float
    """Standard deviation of read noise, electrons."""
    vignette: float
    """Share of the light that is lost in the corners."""


_SETTINGS = {
    "day": (1.0, 9000.0),
    "dusk": (1.9, 2600.0),
    "night": (3.4, 900.0),
    "dark": (13.0, 235.0),
}
"""Exposure factor and electrons at white, by time of day: a higher gain reaches white with fewer electrons, so it is noisier."""


def sensor_of(rng: Rng, light: str) -> Sensor:
    """Return a camera's sensor with random deviations: up to 0.28 stops of exposure and a few per cent of colour balance."""
    exposure, full_well = _SETTINGS[light]
    gain = exposure * float(2 ** rng.uniform(-0.28, 0.28))
    warm = float(rng.uniform(-0.06, 0.06))
    balance = (1 + warm, 1.0, 1 - warm + float(rng.uniform(-0.02, 0.02)))
    return Sensor(gain, balance, full_well, 6.0, float(rng.uniform(0.12, 0.25)))


def develop(radiance: Float32s, sensor: Sensor, exposure: float, rng: Rng) -> Uint8s:
    """Return one capture, (h, w, 3) uint8 sRGB, of linear radiance (h, w, 3); `exposure`: additional factor of this capture."""
    h, w = radiance.shape[:2]
    # 1. The light that reaches the sensor: vignetting grows with the square of the distance from the middle, the lens blurs
    # by half a pixel.
    x = np.linspace(-1, 1, w, dtype=np.float32)
    y = np.linspace(-1, 1, h, dtype=np.float32)[:, None]
    fall = 1 - np.float32(sensor.vignette) * (0.75 * x * x + 0.25 * y * y)
    gain = np.asarray(sensor.balance, np.float32) * np.float32(sensor.gain * exposure)
    light = cv2.GaussianBlur(radiance, (0, 0), 0.45) * fall[..., None] * gain

    # 2. Noise: photons arrive at random, so the variance of a pixel is its number of electrons (Poisson, here Gaussian), to which
    # reading adds its own.  Electrons beyond 1.5 times white are lost.
    noise = rng.standard_normal(light.shape, dtype=np.float32)
    electrons = np.clip(light, 0, 1.5) * np.float32(sensor.full_well)
    electrons += noise * np.sqrt(electrons + np.float32(sensor.read**2))
    return _encode(electrons * np.float32(1 / sensor.full_well))


def _encode(linear: Float32s) -> Uint8s:
    """Return sRGB values, with a soft shoulder so that lamps and sunlit walls do not clip hard."""
    x = np.clip(linear, 0, None)
    x = np.where(x > 0.7, 1 - 0.3 * np.exp(-(x - 0.7) / 0.3), x)
    table = np.linspace(0, 1, 4096)
    curve = np.where(table <= 0.0031308, 12.92 * table, 1.055 * table ** (1 / 2.4) - 0.055)
    return (curve * 255 + 0.5).astype(np.uint8)[(x * 4095 + 0.5).astype(np.intp)]


def clock_size(size: tuple[int, int]) -> tuple[int, int]:
    """Return width and height, pixels, of the clock in the top left corner of an image of `size` = (width, height)."""
    return round(0.40 * size[0]), max(round(0.046 * size[1]), 9)


def burn_clock(image: Uint8s, name: str, time: datetime) -> Uint8s:
    """Return a copy of the image with the camera's name and the time, in white on a dark strip."""
    w, h = clock_size((image.shape[1], image.shape[0]))
    out = image.copy()
    out[:h, :w] //= 4
    text = f"{name.upper()}  {time:%Y-%m-%d  %H:%M:%S}"
    font = cv2.FONT_HERSHEY_SIMPLEX
    # as large as fits, by the width of as many zeros: the size does not change with the time shown
    unit_w, unit_h = cv2.getTextSize("0" * len(text), font, 1.0, 1)[0]
    scale = min(0.94 * w / unit_w, 0.62 * h / unit_h)
    origin = (int(0.02 * w), round(0.5 * (h + scale * unit_h)))
    cv2.putText(out, text, origin, font, scale, (245, 245, 240), max(round(h / 22), 1), cv2.LINE_AA)
    return out


def clock_mask(size: tuple[int, int]) -> Bools:
    """Return (h, w) bool, True where a pixel may be used: everywhere but under the clock."""
    w, h = clock_size(size)
    mask = np.ones(size[::-1], np.bool_)
    mask[:h, :w] = False
    return mask


VEIL = 0.12
"""Share of the scene's light that the veil of rain replaces with a tone of the sky."""
STREAKS = 0.0016
"""Number of rain streaks per pixel of an image 640 pixels wide."""


def add_rain(radiance: Float32s, light: Light, rng: Rng) -> Float32s:
    """Return linear radiance (h, w, 3) as seen through rain: with a veil, and with streaks at random places in every frame."""
    height, width = radiance.shape[:2]
    scale = width / 640
    streaks = np.zeros((height, width), np.uint8)
    slant = rng.normal(0.18, 0.03)  # one wind for all drops
    for _ in range(round(STREAKS * height * width / max(scale, 0.5))):
        x = rng.uniform(0, width)
        y = rng.uniform(-0.05 * height, height)  # some begin above the picture
        long = rng.uniform(8, 34) * scale
        end = (round(x + slant * long), round(y + long))
        cv2.line(streaks, (round(x), round(y)), end, int(rng.integers(35, 130)), max(round(scale), 1), cv2.LINE_AA)
    cover = np.float32(VEIL) + cv2.GaussianBlur(streaks, (0, 0), 0.6 * max(scale, 0.7)).astype(np.float32)[..., None] / 255
    grey = np.asarray(light.haze, np.float32) * np.float32(0.8)
    return np.asarray(radiance * (1 - cover) + grey * cover, np.float32)


def jpeg(image: Uint8s) -> bytes:
    """Return the JPEG file of an image, (h, w, 3) uint8 RGB."""
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(image[..., ::-1]), [cv2.IMWRITE_JPEG_QUALITY, 92])
    return bytes(data.tobytes())


def png(mask: Bools) -> bytes:
    """Return the PNG file of a mask, (h, w) bool: True is white."""
    return rasters.png(mask.astype(np.uint8) * np.uint8(255))
