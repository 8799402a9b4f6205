"""Images and maps of numbers as the bytes of common file formats."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ..types import Float32s, Uint8s, Uint16s

LARGEST_VALUE = 65535
"""The largest value of a 16-bit image."""


def png(image: Uint8s | Uint16s) -> bytes:
    """PNG of (h, w, 3) uint8 RGB, (h, w, 4) uint8 RGBA, or of (h, w) uint8 or uint16."""
    if image.ndim == 3:
        conversion = cv2.COLOR_RGB2BGR if image.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
        image = np.asarray(cv2.cvtColor(image, conversion), np.uint8)
    success, data = cv2.imencode(".png", image)
    if not success:
        raise ValueError(f"no PNG can be made of {image.shape} {image.dtype}")
    return bytes(data.tobytes())


def jpeg(image: Uint8s, quality: int) -> Uint8s:
    """A JPEG file's bytes, (n,) uint8, of (h, w, 3) RGB."""
    _, data = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(data, dtype=np.uint8).ravel()


def pfm(values: Float32s) -> bytes:
    """PFM of (h, w) float32: bottom row first, infinite where `values` is nan."""
    header = f"Pf\n{values.shape[1]} {values.shape[0]}\n-1.0\n".encode()
    return header + np.where(np.isnan(values), np.inf, values).astype("<f4")[::-1].tobytes()


def geotiff(
    bands: npt.NDArray[Any], left: float, top: float, cell: float, epsg: int | None, words: Sequence[str] = (), unit: str = ""
) -> bytes:
    """GeoTIFF of a map.

    A map in a site's own coordinates has no coordinate system, not an engineering one: programs draw the former where its numbers
    say, and refuse the latter, since no transformation leads from it to the project's system (GDAL issue 10820).

    Parameters
    ----------
    bands : (bands, rows, columns) float32, nan where unknown, or (4, rows, columns) uint8 RGBA.
    left, top : x and y of the outer corner of the first cell.
    cell : edge of a cell.
    epsg : EPSG code of the coordinate system, or None.
    words : description of each float32 band.
    unit : of the values of the float32 bands; "" if it is unknown.
    """
    from rasterio.crs import CRS  # imported here: an optional dependency of these exports only
    from rasterio.enums import ColorInterp
    from rasterio.io import MemoryFile
    from rasterio.transform import Affine

    count, rows, columns = bands.shape
    layout = {"driver": "GTiff", "width": columns, "height": rows, "count": count, "dtype": bands.dtype.name}
    layout |= {"crs": CRS.from_epsg(epsg) if epsg else None, "transform": Affine(cell, 0.0, left, 0.0, -cell, top)}
    picture = bands.dtype == np.uint8
    # predictor 2 is TIFF's for integers, 3 that for floating-point numbers
    options: dict[str, Any] = {"nodata": float("nan"), "predictor": 3}
    if picture:
        options = {"photometric": "RGB", "predictor": 2, "tiled": True}
    with MemoryFile() as memory:
        with memory.open(**layout, **options, compress="deflate", num_threads=1) as file:
            if picture:
                file.colorinterp = (ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha)
                file.write(bands)
            for k, description in enumerate(words, 1):
                file.write(bands[k - 1], k)
                file.set_band_description(k, description)
                file.set_band_unit(k, unit)
        return bytes(memory.read())


def stepped(values: npt.NDArray[Any], lowest: float) -> tuple[Uint16s, float]:
    """A map of numbers quantised to 16 bits, and the number of steps per unit.

    0 where `values` is nan, else value = (step - 1) / steps_per_unit + lowest.  The number of steps per unit is 1, 2 or 5
    times a power of ten: the largest with which all values fit.
    """
    known = np.isfinite(values)
    span = 0.0
    if known.any():
        span = float(values[known].max()) - lowest
    steps = 1.0
    if span > 0:
        steps = _preferred_below((LARGEST_VALUE - 2) / span)  # 0 is unknown, and rounding may add one
    quantised = np.zeros(values.shape, np.uint16)
    quantised[known] = np.round((values[known].astype(np.float64) - lowest) * steps + 1)
    return quantised, steps


def _preferred_below(value: float) -> float:
    """The largest of 1, 2 or 5 times a power of ten that is not above `value`."""
    decade = 10.0 ** float(np.floor(np.log10(value)))
    multiple = max(value / decade, 1.0)  # just below 1 by rounding, for a power of ten
    return float(decade * max(step for step in (1.0, 2.0, 5.0) if step <= multiple))
