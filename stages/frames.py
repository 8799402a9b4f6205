"""A camera's captures of one night become one clean frame: upright, undistorted, at working resolution, moving things removed.

Image files from the field arrive empty, cut short, black or from another camera.  Each such case is told apart here, by name,
because what the operator has to do about it differs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import atan, degrees, radians, tan

import cv2
import numpy as np

from .core.cameras import scaled_intrinsics
from .io.exif import focal_in_long_sides
from .io.header import picture_size
from .io.jpeg import SCAN, jpeg_segments
from .types import Bools, Capture, Float64s, Frame, Lens, Uint8s, View

MOST_PIXELS = 200_000_000
"""Of an image that is decoded, unless its size is stated: 0.6 GB, and twice that while colours are put in order."""


class BadCapture(ValueError):
    """A capture that can't be used."""


class EmptyCapture(BadCapture):
    """The file has no bytes."""


class NotAnImage(BadCapture):
    """The bytes are no image that can be decoded."""


class TruncatedImage(BadCapture):
    """The file ends before the image does."""


class OversizedImage(BadCapture):
    """More pixels than are decoded: a few bytes can promise gigabytes."""


class FeaturelessImage(BadCapture):
    """Black, white or uniform: nothing to see."""


class WrongSize(BadCapture):
    """Not the size that the intrinsics, the mask or the night's other captures have."""


def clean_frame(
    captures: Sequence[Capture],
    lens: Lens,
    mask: Capture | None,
    *,
    resolution: int | None = 1600,
    max_captures: int = 15,
) -> Frame:
    """Make the night's frame of one camera.

    Three and more usable captures are brought to one exposure and merged by the median of each pixel, which removes what moves.
    Two have no majority: the later one is used.  Damaged captures are left out and noted.

    Parameters
    ----------
    captures
        The night's image files of this camera, in the order of time; all of one size.
    lens
        Intrinsics and distortion of the image as captured (after its EXIF orientation is applied).
    mask
        An image of the captured size, or None: pixels that are not zero may be used.
    resolution
        Long side of the frame in pixels; None: as captured.  Images are never enlarged.
    max_captures
        At most so many captures are merged, spread evenly over the night: bounds memory and time.

    Raises
    ------
    ValueError
        (`BadCapture` and its kinds) when no capture can be used, or the mask can't; the message names the file and the fault.
    """
    if not captures:
        raise EmptyCapture("no capture was found for this night")
    clean: list[tuple[_Pinhole, str, Uint8s]] = []
    notes: list[str] = []
    for capture in _spread(captures, max_captures):
        try:
            image = decode(capture, lens)
            camera = _Pinhole.of(image, _as_written(lens, capture, image), capture.name)
            clean.append((camera, capture.name, _resize(camera.undistort(image), resolution)))
        except BadCapture as error:
            if len(captures) == 1:
                raise
            notes.append(f"{error}; left out")
    if not clean:
        raise BadCapture("none of this night's captures can be used: " + "; ".join(notes))
    camera, names, images = _most_common_size(clean, notes)
    if len(captures) > max_captures:
        notes.append(f"{max_captures} of {len(captures)} captures used")
    merged = merge(images)
    if len(images) == 2:
        notes.append(f"two captures have no majority: only {names[1]} is used")
    height, width = merged.shape[:2]
    usable = _usable(camera, mask, width, height)
    return Frame(merged, usable, camera.view(width, height), tuple(notes), **_looks(merged, usable))


def working_size(width: int, height: int, resolution: int | None) -> tuple[int, int]:
    """(width, height) in pixels of an image brought to a long side of `resolution`; never larger than it is."""
    if resolution is not None and resolution < 1:
        raise ValueError(f"resolution is {resolution}, at least 1 pixel is needed")
    if resolution is None or resolution >= max(width, height):
        return width, height
    scale = resolution / max(width, height)
    return max(1, round(width * scale)), max(1, round(height * scale))


def decode(capture: Capture, lens: Lens | None = None) -> Uint8s:
    """Decode an image file into (h, w, 3) uint8 RGB, turned upright as its EXIF data say.

    lens: where it states the size of captures, one whose header promises another is not decoded at all.

    Raises
    ------
    BadCapture
        Empty, no image, truncated, too large, of another size, or without any content (black, white, uniform).
    """
    data = np.ascontiguousarray(capture.data)
    if data.size == 0:
        raise EmptyCapture(f"{capture.name} is empty (0 bytes)")
    written = data.tobytes()
    _refuse_truncated(capture.name, written)
    _refuse_size(capture.name, picture_size(written), lens)
    image = _decoded(data, cv2.IMREAD_COLOR)
    if image is None:
        raise NotAnImage(f"{capture.name} is no image that can be read ({data.size:,} bytes)")
    _refuse_featureless(capture.name, image)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def merge(images: Sequence[Uint8s]) -> Uint8s:
    """The static scene of several (h, w, 3) uint8 images of one view: exposures made equal, then the median of each pixel."""
    if len(images) < 3:
        return images[-1]
    small = np.stack([cv2.resize(image, (96, 64), interpolation=cv2.INTER_AREA) for image in images]).astype(np.float32)
    reference = np.median(small, axis=0)
    stack = [_with_gain(image, _gain(thumbnail, reference)) for image, thumbnail in zip(images, small, strict=True)]
    merged = np.empty_like(images[0])
    median = len(stack) // 2
    for top in range(0, len(merged), 64):  # by strips: a night's stack is held once, as bytes
        strip = np.stack([image[top : top + 64] for image in stack])
        merged[top : top + 64] = np.partition(strip, median, axis=0)[median]
    return merged


@dataclass(frozen=True)
class _Pinhole:
    """Size and intrinsics of an image as captured; K is a guess from the field of view unless `focal_known`."""

    width: int
    height: int
    K: Float64s | None
    focal_known: bool
    distortion: Float64s

    @classmethod
    def of(cls, image: Uint8s, lens: Lens, name: str) -> _Pinhole:
        height, width = image.shape[:2]
        if lens.width and lens.height and (width, height) != (lens.width, lens.height):
            raise _wrong_size(name, width, height, lens)
        return cls(width, height, *_intrinsics(lens, width, height), lens.distortion)

    def undistort(self, image: Uint8s, nearest: bool = False) -> Uint8s:
        """Remove distortion, K stays; pixels without a source become 0."""
        if self.K is None or not np.any(self.distortion):
            return image
        maps = cv2.initUndistortRectifyMap(self.K, self.distortion, None, self.K, (self.width, self.height), cv2.CV_32FC1)
        how = cv2.INTER_NEAREST if nearest else cv2.INTER_LINEAR
        return np.asarray(cv2.remap(image, *maps, how, borderMode=cv2.BORDER_CONSTANT, borderValue=0), dtype=np.uint8)

    def view(self, width: int, height: int) -> View:
        K = None if self.K is None else scaled_intrinsics(self.K, width / self.width, height / self.height)
        removed = np.zeros(5) if K is None else self.distortion
        return View(width, height, K, self.focal_known and K is not None, self.width, self.height, removed)


def _intrinsics(lens: Lens, width: int, height: int) -> tuple[Float64s | None, bool]:
    """K of the captured image, and whether its focal length is known rather than guessed from a field of view."""
    if lens.K is not None:
        return lens.K, True
    if lens.hfov_deg is None:
        return None, False
    f = 0.5 * width / tan(0.5 * radians(lens.hfov_deg))
    return np.array([[f, 0.0, 0.5 * (width - 1)], [0.0, f, 0.5 * (height - 1)], [0.0, 0.0, 1.0]]), False


def _as_written(lens: Lens, capture: Capture, image: Uint8s) -> Lens:
    """The lens, with the field of view that the capture's EXIF data tell where the site says nothing."""
    if lens.K is not None or lens.hfov_deg is not None:
        return lens
    focal = focal_in_long_sides(capture.data)
    height, width = image.shape[:2]
    return lens if focal is None else replace(lens, hfov_deg=2 * degrees(atan(0.5 * width / (focal * max(width, height)))))


def _spread(captures: Sequence[Capture], count: int) -> list[Capture]:
    if len(captures) <= count:
        return list(captures)
    return [captures[i] for i in np.linspace(0, len(captures) - 1, count).round().astype(int)]


def _most_common_size(
    clean: Sequence[tuple[_Pinhole, str, Uint8s]], notes: list[str]
) -> tuple[_Pinhole, list[str], list[Uint8s]]:
    """The captures of the most common size (the later one's among equals); the others are noted."""
    sizes = [(camera.width, camera.height) for camera, _, _ in clean]
    width, height = max(reversed(sizes), key=sizes.count)
    for camera, name, _ in clean:
        if (camera.width, camera.height) != (width, height):
            notes.append(f"{name} has {camera.width} x {camera.height} pixels, most have {width} x {height}; left out")
    kept = [entry for entry, size in zip(clean, sizes, strict=True) if size == (width, height)]
    return kept[0][0], [name for _, name, _ in kept], [image for _, _, image in kept]


def _wrong_size(name: str, width: int, height: int, lens: Lens) -> WrongSize:
    turned = (height, width) == (lens.width, lens.height)
    remedy = "state the intrinsics for the size captured, or set the camera back"
    if turned:
        remedy = "is the camera turned, or the EXIF orientation wrong?"
    return WrongSize(f"{name} has {width} x {height} pixels, the intrinsics are for {lens.width} x {lens.height}: {remedy}")


def _refuse_size(name: str, size: tuple[int, int] | None, lens: Lens | None = None) -> None:
    """By the header alone, before memory is asked for what it promises.  The image may lie on its side: EXIF data turn it."""
    if size is None:
        return
    width, height = size
    if lens and lens.width and lens.height and sorted(size) != sorted((lens.width, lens.height)):
        raise _wrong_size(name, width, height, lens)
    if width * height > MOST_PIXELS:
        raise OversizedImage(
            f"{name} has {width} x {height} pixels, {MOST_PIXELS // 10**6} million are the most that are decoded"
        )


def _refuse_truncated(name: str, data: bytes) -> None:
    """JPEG must have an end marker after its first scan, PNG a last chunk; decoders pad the rest with grey and only mutter."""
    if data[:3] == b"\xff\xd8\xff":
        scan = next((start for marker, start, _ in jpeg_segments(data) if marker == SCAN), None)
        whole = scan is not None and data.find(b"\xff\xd9", scan) >= 0
    elif data[:8] == b"\x89PNG\r\n\x1a\n":
        whole = data.rfind(b"IEND") >= 0
    else:
        return
    if not whole:
        raise TruncatedImage(f"{name} ends after {len(data):,} bytes: the image is truncated")


def _decoded(data: Uint8s, flags: int) -> Uint8s | None:
    try:
        image = cv2.imdecode(data, flags)
    except cv2.error:
        return None
    return None if image is None else np.asarray(image, dtype=np.uint8)


def _refuse_featureless(name: str, image: Uint8s) -> None:
    """Averaging over cells removes sensor noise; what then spans less than six grey levels shows nothing."""
    cells = cv2.resize(image, (48, 32), interpolation=cv2.INTER_AREA).astype(np.float32).mean(axis=2)
    low, high = np.percentile(cells, [1, 99])
    if high - low >= 6:
        return
    look = "black" if high < 24 else "white" if low > 231 else "uniform"
    raise FeaturelessImage(f"{name} is {look}: nothing can be seen in it; look at the camera, its lens and its light")


def _looks(image: Uint8s, usable: Bools) -> dict[str, float]:
    """How a frame looks, in the figures of `Frame`, by which nights are compared."""
    grey = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
    smooth = cv2.GaussianBlur(grey, (0, 0), 1.0)  # the sensor's noise is no sharpness
    edges = cv2.Laplacian(smooth, cv2.CV_32F)[usable]
    levels = grey[usable]
    contrast = float(levels.std())
    return {
        "brightness": float(levels.mean()),
        "contrast": contrast,
        "saturated": float(np.mean((levels <= 2) | (levels >= 253))),
        "sharpness": float(edges.std() / max(contrast, 1.0)),
    }


def _resize(image: Uint8s, resolution: int | None) -> Uint8s:
    size = working_size(image.shape[1], image.shape[0], resolution)
    if size == (image.shape[1], image.shape[0]):
        return image
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _gain(thumbnail: np.ndarray, reference: np.ndarray) -> Float64s:
    """(3,) factors per channel that bring a thumbnail to the reference's exposure: robust to what moved, blind to clipping."""
    usable = (thumbnail > 8) & (thumbnail < 247) & (reference > 8) & (reference < 247)
    gains = np.ones(3)
    for c in range(3):
        ratios = reference[..., c][usable[..., c]] / thumbnail[..., c][usable[..., c]]
        if ratios.size >= 50:
            gains[c] = np.median(ratios)
    return gains


def _with_gain(image: Uint8s, gains: Float64s) -> Uint8s:
    table = np.clip(np.arange(256)[:, None] * gains[None, :] + 0.5, 0, 255).astype(np.uint8)
    return np.asarray(cv2.LUT(image, table.reshape(256, 1, 3)), dtype=np.uint8)


def _usable(camera: _Pinhole, mask: Capture | None, width: int, height: int) -> Bools:
    """(height, width) bool: covered by the sensor after undistortion, and allowed by the mask."""
    allowed = np.full((camera.height, camera.width), 255, np.uint8) if mask is None else _decode_mask(mask, camera)
    allowed = camera.undistort(allowed, nearest=True)
    if (width, height) != (camera.width, camera.height):
        allowed = np.asarray(cv2.resize(allowed, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)
    usable: Bools = allowed > 250  # a reduced pixel counts where all it covers does
    if not usable.any():
        name = "the distortion" if mask is None else mask.name
        raise BadCapture(f"{name} leaves no pixel to use: in a mask, zero means 'ignore' and anything else 'use'")
    return usable


def _decode_mask(mask: Capture, camera: _Pinhole) -> Uint8s:
    """(h, w) uint8 of the captured size, 255 where pixels may be used."""
    if mask.data.size == 0:
        raise EmptyCapture(f"mask {mask.name} is empty (0 bytes)")
    _refuse_truncated(f"mask {mask.name}", mask.data.tobytes())
    promised = picture_size(mask.data.tobytes())
    if promised and sorted(promised) != sorted((camera.width, camera.height)):
        raise _wrong_mask(mask.name, *promised, camera)
    image = _decoded(np.ascontiguousarray(mask.data), cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise NotAnImage(f"mask {mask.name} is no image that can be read ({mask.data.size:,} bytes)")
    height, width = image.shape
    if (width, height) != (camera.width, camera.height):
        raise _wrong_mask(mask.name, width, height, camera)
    return np.where(image > 0, 255, 0).astype(np.uint8)


def _wrong_mask(name: str, width: int, height: int, camera: _Pinhole) -> WrongSize:
    return WrongSize(
        f"mask {name} has {width} x {height} pixels, the captures {camera.width} x {camera.height}: "
        "draw the mask over a capture as it comes from the camera"
    )
