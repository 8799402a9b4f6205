"""A camera's captures of one night become one clean frame: upright, undistorted, at working resolution, moving things removed.

Image files from the field arrive empty, cut short, black or from another camera.  Each such case is distinguished here, by name,
because what the operator has to do about it differs.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import atan, degrees
from typing import TypeVar

import cv2
import numpy as np

from .capture.background import merge
from .capture.clock import running_clock
from .capture.files import BadCapture, EmptyCapture, WrongSize, decoded, refuse_truncated
from .capture.image_statistics import blur_px, detail_px, image_statistics, weigh
from .capture.privacy import around, blanked, private_area
from .capture.signal import NOISY, Signal, denoised, put_right, remaining_noise, signal_of
from .capture.straight import Straight
from .capture.video import all_pictures
from .io.image_headers import focal_in_long_sides, picture_size, taken_at
from .types import Bools, Capture, Frame, Lens, Privacy, Uint8s

_T = TypeVar("_T")


def clean_frame(
    captures: Sequence[Capture],
    lens: Lens,
    mask: Capture | None,
    privacy: Privacy | None = None,
    *,
    resolution: int | None = 1600,
    max_captures: int = 15,
    video_step: int = 25,
    overlays: bool = True,
    denoise: bool = True,
    whole_field: bool = False,
) -> Frame:
    """Make the night's frame of one camera.

    Three and more usable captures are brought to one exposure and merged by the median of each pixel, which removes what moves;
    those that are blurred, dark or blinded compared with the others count less.  Two have no majority: the later one is used.
    Where no majority agrees, the frame is masked.  Damaged captures are left out and noted.  Raises ValueError (`BadCapture` and
    its kinds) when no capture can be used, or the mask can't; the message names file and fault.

    Parameters
    ----------
    captures : the night's image files of this camera, in the order of time; all of one size.  Of a video, pictures are taken.
    lens : intrinsics and distortion of the image as captured (after its EXIF orientation is applied).
    mask : an image of the captured size, or None: pixels that are not zero may be used.
    privacy : polygons whose pixels are gone before anything else looks at a capture; None: there are none.
    resolution : long side of the frame in pixels; None: as captured.  Images are never enlarged.
    max_captures : at most so many captures are merged, spread evenly over the night: bounds memory and time.
    video_step : of a video, every so many-th picture is taken, or fewer where these would be more than `max_captures`.
    overlays : clocks, logos and captions are looked for, as pixels that stay while the exposure changes, and masked.
    denoise : noise is taken off where much of it is left in the frame (a night without lamps).
    whole_field : of a brown lens all that it sees (up to 110 degrees) becomes the frame; else what has place in a frame with the
        lens's own K and size, which cuts off the corners of wide lenses.  Of other lenses all that they see always does.
    """
    if not captures:
        raise EmptyCapture("no capture was found for this night")
    clean: list[_Clean] = []
    faults: list[BadCapture] = []
    camera: Straight | None = None
    for capture in (chosen := _spread(captures, max_captures)):
        try:
            for name, image in all_pictures(capture, video_step, max_captures, lens):
                if camera is None or lens.K is None or image.shape[:2] != (camera.height, camera.width):
                    camera = Straight.of(image, _as_written(lens, capture, image), name, whole_field)
                clean.append(_cleaned(image, camera, name, privacy, resolution))
        except BadCapture as error:
            if len(captures) == 1:
                raise
            faults.append(error)
    if not clean:
        raise BadCapture(f"none of this night's captures can be used: {_listed(faults)}")
    notes = [f"{fault}; left out" for fault in faults]
    clean = _spread(_most_common_size(clean, notes), max_captures)
    used = [f"{max_captures} of {len(captures)} captures used"] if len(captures) > max_captures else []
    return _one_frame(clean, mask, (overlays, denoise), chosen, [*notes, *clean[0].camera.lost(), *used])


def _listed(faults: Sequence[BadCapture]) -> str:
    """What is wrong, once for each kind."""
    alike: dict[type, list[BadCapture]] = {}
    for fault in faults:
        alike.setdefault(type(fault), []).append(fault)
    return "; ".join(f"{first}{f' (and {len(more)} more like it)' if more else ''}" for first, *more in alike.values())


def _one_frame(
    clean: Sequence[_Clean], mask: Capture | None, asked: tuple[bool, bool], captures: Sequence[Capture], notes: list[str]
) -> Frame:
    """The frame of clean pictures of one size; asked: whether overlays are masked, and noise is taken off."""
    overlays, denoise = asked
    camera, images, names = clean[0].camera, [each.image for each in clean], [each.name for each in clean]
    height, width = images[0].shape[:2]
    usable = _usable(camera, mask, width, height)
    private = _seen_privately(clean[0], width, height)
    allowed = usable & ~private
    weights, words = weigh(images, names, allowed)
    background = merge(images, weights)
    signal = Signal.median([each.signal for each in clean])
    for repair in dict.fromkeys(each.repair for each in clean if each.repair):
        notes.append(f"{sum(each.repair == repair for each in clean)} of {len(clean)} captures are combed: {repair}")
    notes.extend(signal.words())
    if len(images) == 2:
        notes.append(f"two captures have no majority: only {names[1]} is used")
    trusted = allowed & ~background.doubtful
    if overlays and (overlaid := int((background.overlaid & allowed).sum())):
        notes.append(f"a clock or logo is masked: {overlaid:,} pixels")
        trusted &= ~background.overlaid
    if overlays and (clock := running_clock(images, trusted)):
        x, y, wide, high = clock
        notes.append(f"a clock runs in its picture ({wide} x {high} px at {x}, {y}): name a mask for it")
    if not trusted.any():
        raise BadCapture("the mask, privacy polygons and what moves leave no pixel to use")
    taken = taken_at(captures)
    noise = remaining_noise(signal.noise, len(images), width / camera.width)
    image = background.image
    if denoise and noise >= NOISY:
        image = denoised(image, noise)
        notes.append(f"noisy, {signal.noise:.0f} grey levels a capture: denoised")
    return Frame(
        blanked(image, private if private.any() else None),
        trusted,
        camera.view(width, height),
        (*notes, *words),
        **vars(image_statistics(background.image, allowed)),
        **vars(signal),
        blur_px=blur_px(background.image, allowed),
        detail_px=detail_px(background.image, allowed, noise),
        noise_left=noise,
        coarseness=1 + (signal.blocking - 1) * width / camera.width,
        frames_used=len(images) - len(words),
        doubtful=float((background.doubtful & allowed).mean()),
        unchanged=background.unchanged,
        taken_first=taken[0].isoformat() if taken else "",
        taken_last=taken[-1].isoformat() if taken else "",
        taken_in_order=list(taken) == sorted(taken),
        picture_digest=clean[-1].digest,
    )


@dataclass(frozen=True)
class _Clean:
    """A picture ready to be merged."""

    camera: Straight
    name: str
    image: Uint8s
    """At working resolution, undistorted, without what nobody may see."""
    private: Bools | None
    """What that is, in the capture."""
    signal: Signal
    """What electronics and coding have done to the capture."""
    repair: str
    """What was done about that; "" where nothing."""
    digest: str
    """Of the capture's pixels."""


def _cleaned(image: Uint8s, camera: Straight, name: str, privacy: Privacy | None, resolution: int | None) -> _Clean:
    area = private_area(privacy, camera.width, camera.height, name)
    image = blanked(image, area)  # first: no figure may depend on what is private
    digest = hashlib.sha256(image.tobytes()).hexdigest()[:32]
    signal, (image, repair) = signal_of(image), put_right(image)
    straight = _resized(camera.undistort(image), *camera.working_size(resolution))
    return _Clean(camera, name, straight, area, signal, repair, digest)


def _seen_privately(clean: _Clean, width: int, height: int) -> Bools:
    """(height, width) bool, True where a pixel of the frame, or one near it, is one that nobody may see."""
    if clean.private is None:
        return np.zeros((height, width), np.bool_)
    area = _resized(clean.camera.undistort(around(clean.private).astype(np.uint8) * np.uint8(255)), width, height)
    return np.asarray(area > 0, np.bool_)


def _as_written(lens: Lens, capture: Capture, image: Uint8s) -> Lens:
    """The lens, with the field of view that the capture's EXIF data tell where the site says nothing."""
    if lens.K is not None or lens.hfov_deg is not None:
        return lens
    focal = focal_in_long_sides(capture.data)
    height, width = image.shape[:2]
    return lens if focal is None else replace(lens, hfov_deg=2 * degrees(atan(0.5 * width / (focal * max(width, height)))))


def _spread(found: Sequence[_T], count: int) -> list[_T]:
    if len(found) <= count:
        return list(found)
    return [found[i] for i in np.linspace(0, len(found) - 1, count).round().astype(int)]


def _most_common_size(clean: Sequence[_Clean], notes: list[str]) -> list[_Clean]:
    """The captures of the most common size (the later one's among equals); the others are noted."""
    sizes = [(each.camera.width, each.camera.height) for each in clean]
    width, height = max(reversed(sizes), key=sizes.count)
    for each, size in zip(clean, sizes, strict=True):
        if size != (width, height):
            notes.append(f"{each.name} has {size[0]} x {size[1]} pixels, most have {width} x {height}; left out")
    return [each for each, size in zip(clean, sizes, strict=True) if size == (width, height)]


def _resized(image: Uint8s, width: int, height: int) -> Uint8s:
    if (width, height) == (image.shape[1], image.shape[0]):
        return image
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _usable(camera: Straight, mask: Capture | None, width: int, height: int) -> Bools:
    """(height, width) bool: covered by the sensor after undistortion, and allowed by the mask."""
    allowed = np.full((camera.height, camera.width), 255, np.uint8) if mask is None else _decode_mask(mask, camera)
    allowed = _resized(camera.undistort(allowed, nearest=True), width, height)
    usable: Bools = allowed > 250  # a reduced pixel counts where all it covers does
    if not usable.any():
        name = "the distortion" if mask is None else mask.name
        raise BadCapture(f"{name} leaves no pixel to use: in a mask, zero means 'ignore' and anything else 'use'")
    return usable


def _decode_mask(mask: Capture, camera: Straight) -> Uint8s:
    """(h, w) uint8 of the captured size, 255 where pixels may be used."""
    if mask.data.size == 0:
        raise EmptyCapture(f"mask {mask.name} is empty (0 bytes)")
    refuse_truncated(f"mask {mask.name}", mask.data.tobytes())
    promised = picture_size(mask.data.tobytes())
    if promised and sorted(promised) != sorted((camera.width, camera.height)):
        raise _wrong_mask(mask.name, *promised, camera)
    image = decoded(f"mask {mask.name}", np.ascontiguousarray(mask.data), cv2.IMREAD_GRAYSCALE)
    height, width = image.shape
    if (width, height) != (camera.width, camera.height):
        raise _wrong_mask(mask.name, width, height, camera)
    return np.where(image > 0, 255, 0).astype(np.uint8)


def _wrong_mask(name: str, width: int, height: int, camera: Straight) -> WrongSize:
    return WrongSize(
        f"mask {name} has {width} x {height} pixels, the captures {camera.width} x {camera.height}: "
        "draw the mask over a capture as it comes from the camera"
    )
