"""Images that are too blurred, noisy, badly lit or coarsely coded for measuring.

Some are by themselves: what is measured in the image exceeds a limit.  Others are by what comes of them: the errors of a camera's
points, as a multiple of the expected errors (`misfit`, about 1 if all is well), alone or together with what may have caused
them.  The limits were fitted on scenes with known truth, so that they are exceeded where less than nine in ten points are right.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from statistics import median

from ..records.findings import Finding, finding
from ..records.record import CameraRecord, RunRecord
from .facts import Facts
from .wording import listed

SOFT_PX = 1.3
"""Images are soft if their sharper edges are blurred by more than this (standard deviation, pixels).  Smaller: the softest parts
of good photographs count, too (measured: 0.8 at most when scaled down, 1.0 unscaled)."""
COARSE = 1.465
"""Images are soft above this JPEG blockiness, a ratio, at working resolution.  Smaller: ordinary coding counts, too (measured:
1.1 to 1.45 at quality 50, 1.48 at quality 20)."""
NOISY = 10.0
"""Images are soft if more noise than this is left, in grey levels.  Larger: fewer points are right when it is reported (measured:
86 % with a noise of 13, 95 % with 6)."""
OVEREXPOSED = 0.5
"""Images are doubtful if a larger share of their pixels is pure white.  Smaller: the white sky of a grey day counts, too."""
FAINT = 10.0
"""Images are doubtful if their grey levels have a smaller standard deviation, since eight bits and JPEG leave little detail.
Larger: thin fog counts, too (measured: 4.2 to 9.1 in thick fog or underexposed, 10.5 and more in thin fog, 17 to 76 else)."""
MOST_MISFIT = 2.0
"""Images are doubtful if the misfit of their points exceeds this, whatever the cause.  Smaller: JPEG quality 50 counts, too."""
LEAST_MISFIT = 1.1
"""Images are unresolved (see `UNRESOLVED`) only if the misfit of their points exceeds this."""
UNRESOLVED = 2.2
"""Images are doubtful if the misfit of their points times the pixels between details exceeds this: enlarged or smeared, they have
fewer details than pixels (measured: unaltered 0.5 to 1.4, smeared by 5 px 2.0, by 7 px 3.9, enlarged three times 4.0)."""
BLURRED_BY_CODING = 2.45
"""Images are doubtful if the misfit of their points times their JPEG blockiness exceeds this.  Smaller: ordinary coding counts,
too (measured: 1.4 to 2.35 at quality 50, 2.6 to 4 at quality 20)."""
UNSTEADY = 1.0
"""Images are doubtful if the misfit of their points times the median distance, in pixels, of their matches from the epipolar
lines of their pairs' own F exceeds this: hot air and shaking distort images as no F does (measured: at most 0.75 on nights
as they should be, 0.96 with a solved pose that is off, 1.1 to 1.5 in hot air that moves pixels by 1 px)."""
WORSE_THAN_USUAL = 1.5
"""Images are doubtful if the misfit of their points exceeds the usual one by this factor (measured: at most 1.3 by other weather,
light, noise and JPEG quality 50; 1.4 to 2.2 in hot air or at quality 20)."""
SOFT_SHARE = 1 / 3
"""Unless an image is soft by itself, doubtful images are reported only from this share of the cameras in use: a single camera may
see what is hard to measure."""


def check_pictures(record: RunRecord, facts: Facts) -> Iterator[Finding]:
    """Are images too blurred, noisy, badly lit or coarsely coded for measuring?"""
    used = [camera for camera in record.cameras if camera.ok]
    reported = [camera for camera in used if _is_soft(camera) or _is_doubtful(camera, record)]
    if not reported:
        return
    # doubtful images of few cameras are reported only beside soft ones: see `SOFT_SHARE`
    is_certain = any(_is_soft(camera) for camera in reported)
    if is_certain or len(reported) >= SOFT_SHARE * len(used):
        yield _soft_finding(reported, record)


def _soft_finding(cameras: Sequence[CameraRecord], record: RunRecord) -> Finding:
    """Return the finding about soft and doubtful images, with the worst value of each figure."""
    figures = [camera.figures for camera in cameras]
    worst = {
        "blur_px": max(_measured(each.blur_px) for each in figures),
        "coarseness": max(_measured(each.coarseness) for each in figures),
        "noise_left": max(_measured(each.noise_left) for each in figures),
        "detail_px": max(_measured(each.detail_px) for each in figures),
        "saturated": max(_measured(each.saturated) for each in figures),
        "contrast": min(_measured(each.contrast) for each in figures),  # here the smallest is the worst
        "misfit": max(_measured(each.misfit) for each in figures),
        "off_px": max(_off_px(camera, record) for camera in cameras),
    }
    fit = ""
    if worst["misfit"]:
        fit = f", points {worst['misfit']:.1f} times as far off as expected"
        usual = max(_usual_misfit(camera, record) for camera in cameras)
        if usual:
            fit += f" (usually {usual:.1f})"
    names = tuple(camera.id for camera in cameras)
    return finding("pictures-soft", names, worst, None, None, cameras=listed(names), fit=fit, **worst)


def _is_soft(camera: CameraRecord) -> bool:
    """Is a camera out of focus, noisy or coarsely coded, by its images alone?"""
    figures = camera.figures
    is_blurred = _measured(figures.blur_px) > SOFT_PX
    is_coarse = _measured(figures.coarseness) > COARSE
    is_noisy = _measured(figures.noise_left) > NOISY
    return is_blurred or is_coarse or is_noisy


def _is_doubtful(camera: CameraRecord, record: RunRecord) -> bool:
    """Do a camera's light, or the errors of its points, say that its images are worse than they look?"""
    return (
        _is_overexposed(camera)
        or _is_faint(camera)
        or _is_unresolved(camera)
        or _is_blurred_by_coding(camera)
        or _is_unsteady(camera, record)
        or _is_worse_than_usual(camera, record)
    )


def _is_overexposed(camera: CameraRecord) -> bool:
    return _measured(camera.figures.saturated) > OVEREXPOSED


def _is_faint(camera: CameraRecord) -> bool:
    """Have a camera's images little contrast?  0 means that it was not measured."""
    return 0.0 < _measured(camera.figures.contrast) < FAINT


def _is_unresolved(camera: CameraRecord) -> bool:
    """Are a camera's images less resolved, by their points' errors, than their pixels promise?"""
    misfit = _measured(camera.figures.misfit)
    if misfit > MOST_MISFIT:
        return True
    return misfit > LEAST_MISFIT and misfit * _measured(camera.figures.detail_px) > UNRESOLVED


def _is_blurred_by_coding(camera: CameraRecord) -> bool:
    return _measured(camera.figures.misfit) * _measured(camera.figures.coarseness) > BLURRED_BY_CODING


def _is_unsteady(camera: CameraRecord, record: RunRecord) -> bool:
    """Are a camera's images distorted so that no F fits its matches?"""
    return _measured(camera.figures.misfit) * _off_px(camera, record) > UNSTEADY


def _is_worse_than_usual(camera: CameraRecord, record: RunRecord) -> bool:
    usual = _usual_misfit(camera, record)
    return usual > 0 and _measured(camera.figures.misfit) > WORSE_THAN_USUAL * usual


def _measured(figure: float | None) -> float:
    """Return a figure; 0 if it was not measured."""
    return float(figure or 0.0)


def _usual_misfit(camera: CameraRecord, record: RunRecord) -> float:
    """Return the usual misfit of a camera's points; 0 if it is unknown."""
    if record.usual is None:
        return 0.0
    return record.usual.cameras.get(camera.id, {}).get("misfit", 0.0)


def _off_px(camera: CameraRecord, record: RunRecord) -> float:
    """Median distance of a camera's matches from the epipolar lines of its pairs' own F, pixels."""
    distances = []
    for pair in record.pairs_of(camera.id):
        # matches of improbable pairs may be look-alikes, which are off for another reason
        if pair.ok and (pair.figures.probability or 0.0) > 0.5:
            distances.append(pair.figures.epipolar_px or 0.0)
    if not distances:
        return 0.0
    return median(distances)
