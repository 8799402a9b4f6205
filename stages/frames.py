"""A camera's captures of one night become one clean frame: upright, undistorted, at working resolution, moving things removed.

Image files from the field arrive empty, truncated, black or from another camera.  Each case has its own error here, because
the operator has to act differently.
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
from .capture.files import BadCapture, EmptyCapture, WrongSize, decoded_mask, picture_values, refuse_truncated, stray_bytes
from .capture.image_statistics import blur_px, detail_px, image_statistics, weigh
from .capture.levels import EIGHT_BITS, Levels, Values, levels_of
from .capture.privacy import blanked, private_area, with_margin
from .capture.signal import NOISY, Signal, denoised, remaining_noise, repaired, signal_of
from .capture.straight import CapturePinhole
from .capture.video import DamagedVideo, all_pictures
from .contracts.defaults import RESOLUTION
from .contracts.unknown import known_or_none
from .io.image_headers import focal_in_long_sides, has_deep_values, largest_stated_value, picture_size, taken_at
from .types import Bools, Capture, Frame, Lens, Privacy, Uint8s

_T = TypeVar("_T")


def clean_frame(
    captures: Sequence[Capture],
    lens: Lens,
    mask: Capture | None,
    privacy: Privacy | None = None,
    *,
    resolution: int | None = RESOLUTION,
    max_captures: int = 15,
    video_step: int = 25,
    overlays: bool = True,
    denoise: bool = True,
    whole_field: bool = False,
    levels: tuple[float, float] | None = None,
) -> Frame:
    """Make the night's frame of one camera.

    Three or more usable captures are brought to one exposure and merged by the median of each pixel, which removes moving
    things; captures more blurred, dark or blinded than the others get less weight.  Two captures have no majority: the later
    one is used.  Pixels where no majority agrees are masked.  Damaged captures are left out and noted.  Raises `BadCapture` (a
    ValueError) if the mask or all captures are unusable; the message names file and fault.

    Parameters
    ----------
    captures : the night's image or video files of this camera, in order of time; those of an uncommon size are left out.
    lens : intrinsics and distortion of the image as captured (after its EXIF orientation is applied).
    mask : an image of the captured size whose nonzero pixels may be used; None: all pixels may be used.
    privacy : polygons whose pixels are blanked before anything else reads a capture; None: there are none.
    resolution : long side of the frame in pixels; None: as captured.  Images are never enlarged.
    max_captures : most captures that are merged, spread evenly over the night: bounds memory and time.
    video_step : step in frames between the images taken from a video; longer where there would be more than `max_captures`.
    overlays : find and mask clocks, logos and captions, by pixels that stay the same while the exposure changes.
    denoise : denoise the frame if much noise is left in it (a night without lamps).
    whole_field : for a "brown" lens, make a frame of all that it sees (up to 110 degrees) instead of what fits the lens's own
        K and size, which cuts off the corners of wide lenses.  Frames of other models always show all that the lens sees.
    levels : the values of captures of more than 8 bits that become black and white, such as [0, 4095]; None: found by the depth
        in use (10, 12, 14 or 16 bits), or, for thermal captures, as temperatures on a grid of at least 10 degrees.
    """
    if not captures:
        raise EmptyCapture("no capture was found for this night")
    chosen = _evenly_chosen(captures, max_captures)
    used_levels = _night_levels(chosen) if levels is None else Levels(*levels)
    pictures: list[_Picture] = []
    faults: list[BadCapture] = []
    damages: list[str] = []
    camera: CapturePinhole | None = None
    for capture in chosen:
        try:
            for name, image in all_pictures(capture, video_step, max_captures, lens, used_levels):
                # without intrinsics, each size of picture has a pinhole of its own
                if camera is None or lens.K is None or image.shape[:2] != (camera.height, camera.width):
                    camera = CapturePinhole.of(image, _lens_with_exif(lens, capture, image), name, whole_field)
                pictures.append(_cleaned(image, camera, name, privacy, resolution))
        except DamagedVideo as error:  # raised after its sound frames, which are used
            damages.append(str(error))
        except BadCapture as error:
            if len(captures) == 1:
                raise
            faults.append(error)
    if not pictures:
        raise BadCapture(f"none of this night's captures can be used: {_summary(faults)}")
    notes = [f"{fault}; left out" for fault in faults] + damages
    pictures = _evenly_chosen(_of_common_size(pictures, notes), max_captures)
    notes += pictures[0].camera.loss_notes()
    notes += _notes_on_files(chosen, used_levels)
    if len(captures) > max_captures:
        notes.append(f"{max_captures} of {len(captures)} captures used")
    return _merged_frame(pictures, mask, chosen, notes, overlays=overlays, denoise=denoise)


def _night_levels(captures: Sequence[Capture]) -> Levels:
    """The levels of a camera's captures of more than 8 bits, the same for all of them."""
    deep = [capture for capture in captures if has_deep_values(capture.data[:_HEADER_BYTES].tobytes())]
    if not deep:
        return EIGHT_BITS
    values: list[Values] = []
    for capture in deep:
        try:
            values.append(picture_values(capture))
        except BadCapture:  # reported when it is decoded again, for the frame
            continue
    return levels_of(values, largest_stated_value(deep[0].data.tobytes()))


_HEADER_BYTES = 1 << 20
"""Bytes at the beginning of a file that its header is looked for in."""


def _notes_on_files(captures: Sequence[Capture], levels: Levels) -> list[str]:
    """Notes on what was unusual in the files of captures that are used."""
    notes: list[str] = []
    if levels.what:
        notes.append(levels.words())
    places = [stray_bytes(capture) for capture in captures]
    for place in dict.fromkeys(places):
        if place:
            notes.append(f"{places.count(place)} of {len(captures)} captures hold stray bytes {place}, which are skipped")
    return notes


def _summary(faults: Sequence[BadCapture]) -> str:
    """The faults as one message, with one example of each kind."""
    by_kind: dict[type, list[BadCapture]] = {}
    for fault in faults:
        by_kind.setdefault(type(fault), []).append(fault)
    messages: list[str] = []
    for first, *others in by_kind.values():
        message = str(first)
        if others:
            message += f" (and {len(others)} more like it)"
        messages.append(message)
    return "; ".join(messages)


def _merged_frame(
    pictures: list[_Picture], mask: Capture | None, captures: list[Capture], notes: list[str], *, overlays: bool, denoise: bool
) -> Frame:
    """The frame from clean pictures of one size.  captures: those that the pictures are from, for their times."""
    camera = pictures[0].camera
    images = [picture.image for picture in pictures]
    names = [picture.name for picture in pictures]
    height, width = images[0].shape[:2]
    usable = _usable_pixels(camera, mask, width, height)
    private = _private_pixels(pictures[0], width, height)
    allowed = usable & ~private
    weights, weight_notes = weigh(images, names, allowed)
    background = merge(images, weights)
    signal = Signal.median([picture.signal for picture in pictures])
    repairs = [picture.repair for picture in pictures]
    for repair in dict.fromkeys(repairs):
        if repair:
            notes.append(f"{repairs.count(repair)} of {len(pictures)} captures are combed: {repair}")
    notes.extend(signal.words())
    if len(images) == 2:
        notes.append(f"two captures have no majority: only {names[1]} is used")
    trusted = allowed & ~background.doubtful
    if overlays:
        trusted = _without_overlays(trusted, background.overlaid & allowed, images, notes)
    if not trusted.any():
        raise BadCapture("mask, privacy polygons and moving things leave no pixel to use")
    noise = remaining_noise(signal.noise, len(images), width / camera.width)
    # the statistics are those of the picture before it is denoised
    statistics = image_statistics(background.image, allowed)
    image = background.image
    if denoise and noise >= NOISY:
        image = denoised(image, noise)
        notes.append(f"noisy, {signal.noise:.0f} grey levels a capture: denoised")
    times = taken_at(captures)
    if private.any():
        image = blanked(image, private)
    return Frame(
        image,
        trusted,
        camera.view(width, height),
        notes=(*notes, *weight_notes),
        brightness=known_or_none(statistics.brightness),
        contrast=known_or_none(statistics.contrast),
        saturated=known_or_none(statistics.saturated),
        sharpness=known_or_none(statistics.sharpness),
        combing=signal.combing,
        blocking=signal.blocking,
        cast=signal.cast,
        colour=signal.colour,
        noise=signal.noise,
        blur_px=known_or_none(blur_px(background.image, allowed)),
        detail_px=detail_px(background.image, allowed, noise),
        noise_left=noise,
        coarseness=1 + (signal.blocking - 1) * width / camera.width,
        frames_used=len(images) - len(weight_notes),
        doubtful=float((background.doubtful & allowed).mean()),
        unchanged=background.unchanged,
        taken_first=times[0].isoformat() if times else "",
        taken_last=times[-1].isoformat() if times else "",
        taken_in_order=list(times) == sorted(times),
        picture_digest=pictures[-1].digest,
    )


def _without_overlays(trusted: Bools, overlaid: Bools, images: Sequence[Uint8s], notes: list[str]) -> Bools:
    """The trusted pixels but those of overlays, which are noted, as is a running clock."""
    if overlaid.any():
        notes.append(f"a clock or logo is masked: {overlaid.sum():,} pixels")
        trusted = trusted & ~overlaid
    if clock := running_clock(images, trusted):
        x, y, width, height = clock
        notes.append(f"a clock runs in its picture ({width} x {height} px at {x}, {y}): name a mask for it")
    return trusted


@dataclass(frozen=True)
class _Picture:
    """A picture ready to be merged."""

    camera: CapturePinhole
    name: str
    image: Uint8s
    """At working resolution, undistorted, private areas blanked."""
    private: Bools | None
    """(h, w) the private area in the capture."""
    signal: Signal
    """What electronics and coding have done to the capture: combing, blocks, colour cast, noise."""
    repair: str
    """How combing was repaired, in words; "" where there is none."""
    digest: str
    """First 32 hex digits of the SHA-256 of the capture's pixels, private areas blanked."""


def _cleaned(image: Uint8s, camera: CapturePinhole, name: str, privacy: Privacy | None, resolution: int | None) -> _Picture:
    area = private_area(privacy, camera.width, camera.height, name)
    image = blanked(image, area)  # first: no figure may depend on what is private
    digest = hashlib.sha256(image.tobytes()).hexdigest()[:32]
    signal = signal_of(image)
    image, repair = repaired(image)
    undistorted = _resized(camera.undistort(image), *camera.working_size(resolution))
    return _Picture(camera, name, undistorted, area, signal, repair, digest)


def _private_pixels(picture: _Picture, width: int, height: int) -> Bools:
    """(height, width) bool, True where a pixel of the frame lies in or near a private area."""
    if picture.private is None:
        return np.zeros((height, width), np.bool_)
    area = _resized(picture.camera.undistort(with_margin(picture.private).astype(np.uint8) * np.uint8(255)), width, height)
    return np.asarray(area > 0, np.bool_)


def _lens_with_exif(lens: Lens, capture: Capture, image: Uint8s) -> Lens:
    """The lens, with the field of view from the capture's EXIF data if the site states neither K nor a field of view."""
    if lens.K is not None or lens.hfov_deg is not None:
        return lens
    focal = focal_in_long_sides(capture.data)
    if focal is None:
        return lens
    height, width = image.shape[:2]
    focal_px = focal * max(width, height)
    return replace(lens, hfov_deg=2 * degrees(atan(0.5 * width / focal_px)))


def _evenly_chosen(items: Sequence[_T], count: int) -> list[_T]:
    if len(items) <= count:
        return list(items)
    return [items[i] for i in np.linspace(0, len(items) - 1, count).round().astype(int)]


def _of_common_size(pictures: Sequence[_Picture], notes: list[str]) -> list[_Picture]:
    """The pictures of the most common size (of equally common sizes, the latest); a note is added for each other picture."""
    sizes = [(picture.camera.width, picture.camera.height) for picture in pictures]
    width, height = max(reversed(sizes), key=sizes.count)
    common: list[_Picture] = []
    for picture, size in zip(pictures, sizes, strict=True):
        if size == (width, height):
            common.append(picture)
        else:
            notes.append(f"{picture.name} has {size[0]} x {size[1]} pixels, most have {width} x {height}; left out")
    return common


def _resized(image: Uint8s, width: int, height: int) -> Uint8s:
    if (width, height) == (image.shape[1], image.shape[0]):
        return image
    return np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _usable_pixels(camera: CapturePinhole, mask: Capture | None, width: int, height: int) -> Bools:
    """(height, width) bool: covered by the sensor after undistortion, and allowed by the mask."""
    if mask is None:
        allowed = np.full((camera.height, camera.width), 255, np.uint8)
    else:
        allowed = _decode_mask(mask, camera)
    allowed = _resized(camera.undistort(allowed, nearest=True), width, height)
    usable: Bools = allowed > 250  # a reduced pixel is usable if all pixels that it covers are
    if not usable.any():
        name = "the distortion" if mask is None else mask.name
        raise BadCapture(f"{name} leaves no pixel to use: in a mask, zero means 'ignore' and anything else 'use'")
    return usable


def _decode_mask(mask: Capture, camera: CapturePinhole) -> Uint8s:
    """(h, w) uint8 of the captured size, 255 where pixels may be used."""
    if mask.data.size == 0:
        raise EmptyCapture(f"mask {mask.name} is empty (0 bytes)")
    refuse_truncated(f"mask {mask.name}", mask.data.tobytes())
    stated_size = picture_size(mask.data.tobytes())
    if stated_size and sorted(stated_size) != sorted((camera.width, camera.height)):
        raise _wrong_mask(mask.name, *stated_size, camera)
    allowed = decoded_mask(f"mask {mask.name}", np.ascontiguousarray(mask.data))
    height, width = allowed.shape
    if (width, height) != (camera.width, camera.height):
        raise _wrong_mask(mask.name, width, height, camera)
    return allowed


def _wrong_mask(name: str, width: int, height: int, camera: CapturePinhole) -> WrongSize:
    return WrongSize(
        f"mask {name} has {width} x {height} pixels, the captures {camera.width} x {camera.height}: "
        "draw the mask over a capture as it comes from the camera"
    )
