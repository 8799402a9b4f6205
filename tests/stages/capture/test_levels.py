"""Captures of more than 8 bits: the levels that become black and white."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.helpers.measured import measured
from wbflow_stages.capture.levels import grey_levels_of, levels_of
from wbflow_stages.frames import clean_frame
from wbflow_stages.types import Capture, Float64s, Frame, Lens


def scene(brightness: float = 1.0) -> Float64s:
    """(120, 160) grey levels from 0 to 255, without a trend: what a camera sees, more or less brightly lit."""
    blobs = np.random.default_rng(3).normal(size=(120, 160))
    blobs = np.asarray(cv2.GaussianBlur(blobs, (0, 0), 4), np.float64)
    blobs -= blobs.min()
    return np.asarray(brightness * 250 * blobs / blobs.max(), np.float64)


def encoded(values: NDArray[Any], extension: str, name: str = "gate") -> Capture:
    return Capture(f"{name}{extension}", np.asarray(cv2.imencode(extension, values)[1], np.uint8).ravel())


def frame_of(values: Float64s, extension: str = ".png") -> Frame:
    return clean_frame([encoded(values.round().astype(np.uint16), extension)], Lens(), None, resolution=None, denoise=False)


@pytest.mark.parametrize("extension", [".png", ".tif", ".pgm"])
@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_pictures_of_any_depth_look_like_those_of_8_bits(bits: int, extension: str) -> None:
    frame = frame_of(scene() * 2 ** (bits - 8), extension)
    assert np.abs(frame.image[..., 0] - scene()).max() <= 1
    assert any(f"{bits} bits" in note and f"levels: [0, {2**bits - 1}]" in note for note in frame.notes)


@pytest.mark.parametrize("bits", [10, 12, 14, 16])
def test_a_camera_has_the_same_levels_on_a_darker_night(bits: int) -> None:
    bright = frame_of(scene() * 2 ** (bits - 8))
    dim = frame_of(scene(0.4) * 2 ** (bits - 8))
    assert [note for note in bright.notes if "levels" in note] == [note for note in dim.notes if "levels" in note]
    assert measured(dim.brightness) == pytest.approx(0.4 * measured(bright.brightness), abs=1)


def test_twelve_bits_stored_as_the_upper_ones_of_16_are_not_taken_for_fewer_on_a_dark_night() -> None:
    frame = frame_of((scene(0.05) * 16).round() * 16)
    assert frame.image.max() < 0.05 * 256


def test_a_dark_night_stays_dark() -> None:
    frame = frame_of(scene(0.1) * 16)
    assert frame.image.max() < 30 * 4


def test_colours_keep_their_ratios() -> None:
    values = np.dstack([scene() * share * 16 for share in (0.25, 0.5, 1.0)]).astype(np.uint16)
    frame = clean_frame([encoded(values, ".png")], Lens(), None, resolution=None, denoise=False)
    red, green, blue = frame.image.reshape(-1, 3).mean(axis=0)
    assert green == pytest.approx(red / 2, abs=1) and blue == pytest.approx(red / 4, abs=1)


def centikelvins(celsius: Float64s) -> NDArray[Any]:
    return ((celsius + 273.15) * 100).round().astype(np.uint16)


def decikelvins(celsius: Float64s) -> NDArray[Any]:
    return ((celsius + 273.15) * 10).round().astype(np.uint16)


def kelvins(celsius: Float64s) -> NDArray[Any]:
    return (celsius + 273.15).astype(np.float32)


def degrees(celsius: Float64s) -> NDArray[Any]:
    return celsius.astype(np.float32)


@pytest.mark.parametrize("unit", [centikelvins, decikelvins, kelvins, degrees])
@pytest.mark.parametrize(("coldest", "warmest"), [(-12.0, 4.0), (3.0, 18.0), (14.0, 31.0)])
def test_temperatures_become_grey_levels_with_contrast(
    unit: Callable[[Float64s], NDArray[Any]], coldest: float, warmest: float
) -> None:
    celsius = coldest + scene() / 250 * (warmest - coldest)
    frame = clean_frame([encoded(unit(celsius), ".tif")], Lens(), None, resolution=None, denoise=False)
    assert any(note.startswith("thermal") for note in frame.notes)
    assert np.ptp(frame.image[..., 0].astype(int)) > 70
    assert np.corrcoef(frame.image[..., 0].ravel(), celsius.ravel())[0, 1] > 0.999
    assert frame.image.min() > 0 and frame.image.max() < 255


def test_the_same_temperature_is_the_same_grey_level_on_a_colder_night() -> None:
    warm = levels_of([centikelvins(12 + scene() / 250 * 18)])
    cold = levels_of([centikelvins(8 + scene() / 250 * 18)])
    assert warm == cold


def test_a_hot_spot_and_a_strip_of_sky_do_not_set_the_levels() -> None:
    celsius = 5 + scene() / 250 * 12
    plain = levels_of([centikelvins(celsius)])
    celsius[:1, :80] = -55.0
    celsius[60:62, 70:80] = 140.0
    assert levels_of([centikelvins(celsius)]) == plain


def test_raw_counts_of_a_thermal_sensor_get_contrast() -> None:
    frame = frame_of(7400 + scene() * 2, ".tif")
    assert np.ptp(frame.image[..., 0].astype(int)) > 60


def test_values_that_are_no_numbers_become_black() -> None:
    values = (scene() / 255).astype(np.float32)
    values[:10] = np.nan
    levels = levels_of([values])
    assert (levels.black, levels.white) == (0.0, 1.0)
    grey = grey_levels_of(values, levels)
    assert grey[:10].max() == 0
    assert np.abs(grey[10:] - scene()[10:]).max() <= 1


def test_all_captures_of_a_night_have_the_same_levels() -> None:
    night = [encoded((scene(light) * 16).astype(np.uint16), ".png", str(k)) for k, light in enumerate((0.2, 1.0, 1.0))]
    frame = clean_frame(night, Lens(), None, resolution=None, denoise=False)
    assert [note for note in frame.notes if "12 bits" in note]
    assert not [note for note in frame.notes if "10 bits" in note]


def test_stated_levels_are_used() -> None:
    values = (1000 + scene() * 4).astype(np.uint16)
    frame = clean_frame([encoded(values, ".png")], Lens(), None, resolution=None, denoise=False, levels=(1000.0, 2020.0))
    assert np.abs(frame.image[..., 0] - scene()).max() <= 1


def test_the_white_that_a_file_states_is_used() -> None:
    values = scene(0.9) * 2000 / 255
    header = b"P5\n# camera\n160 120\n2000\n"
    data = header + values.astype(">u2").tobytes()
    frame = clean_frame([Capture("gate.pgm", np.frombuffer(data, np.uint8))], Lens(), None, resolution=None, denoise=False)
    assert np.abs(frame.image[..., 0] - scene(0.9)).max() <= 1
