"""A lamp that is carried through the views of fixed cameras: found by night and by day, and told from other lights."""

from __future__ import annotations

import io
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from tests.helpers.videos import video
from wbflow_stages.recordings import observe_recordings
from wbflow_stages.types import Float32s, Float64s, Observations

WIDTH, HEIGHT, FPS, SECONDS = 480, 270, 5, 20
TIMES = np.arange(FPS * SECONDS) / FPS

More = Callable[[Float32s, float], None]
"""Draws what else there is at a time in seconds."""


def glow(image: Float32s, x: float, y: float, strength: float, sigma: float, tall: float = 1.0) -> None:
    """Add a spot of light; tall: its height over its width."""
    across = np.exp(-((np.arange(WIDTH) - x) ** 2) / (2 * sigma**2))
    along = np.exp(-((np.arange(HEIGHT) - y) ** 2) / (2 * (tall * sigma) ** 2))
    image += (strength * np.outer(along, across)).astype(np.float32)


def lamp_at(time: float) -> tuple[float, float]:
    """Where the lamp is, pixels."""
    return 240 + 150 * np.sin(0.5 * time), 130 + 50 * np.sin(0.9 * time + 1)


def is_lit(time: float) -> bool:
    """It is hidden for two seconds."""
    return not 10 < time < 12


def scene(level: float) -> Float32s:
    """A still scene of some brightness."""
    noise = np.random.default_rng(1).normal(0, 1, (HEIGHT // 6, WIDTH // 6)).astype(np.float32)
    return np.asarray(level * (1 + 0.3 * cv2.resize(noise, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)), np.float32)


def recorded(level: float, more: More | None = None, lit: Callable[[float], bool] = is_lit) -> io.BytesIO:
    """A recording of the lamp in a scene."""
    rng = np.random.default_rng(2)
    still = scene(level)
    frames = []
    for time in TIMES.tolist():
        image = still.copy()
        if more:
            more(image, time)
        if lit(time):
            x, y = lamp_at(time)
            glow(image, x, y, 900, 1.3)
            glow(image, x, y, 40, 14)
        image += rng.normal(0, 3, image.shape).astype(np.float32)
        frames.append(np.repeat(np.clip(image, 0, 255).astype(np.uint8)[..., None], 3, axis=2))
    return video(frames, FPS, crf=20)


def observed(file: io.BytesIO) -> Observations:
    """What is found in a recording, beside one of a few dark frames."""
    return observe_recordings({"a": file, "b": video([np.zeros((90, 160, 3), np.uint8)] * 3)}).observations


def errors_px(observations: Observations) -> Float64s:
    """Distance of each observation of the first camera from the lamp."""
    own = observations.camera == 0
    truth = np.array([lamp_at(time) for time in observations.time[own]])
    return np.asarray(np.linalg.norm(observations.xy[own] - truth, axis=1))


def nothing(image: Float32s, time: float) -> None:
    pass


def fixed_lamps(image: Float32s, time: float) -> None:
    """One that shines, one that blinks, and one that is switched on after two thirds of the time."""
    glow(image, 100, 60, 900, 2)
    if int(time * 5) % 15 < 5:
        glow(image, 380, 50, 900, 2)
    if time > 13:
        glow(image, 60, 180, 900, 2)


def car(image: Float32s, time: float) -> None:
    """Two headlights, brighter than the lamp, that cross the picture in three seconds."""
    if 5 < time < 8:
        x = 480 * (time - 5) / 3
        for shift in (-14, 14):
            glow(image, x + shift, 200, 2000, 3)


def wet_ground(image: Float32s, time: float) -> None:
    """A long reflection under the lamp, as bright as the sensor can show."""
    if is_lit(time):
        x, y = lamp_at(time)
        glow(image, x, y + 70, 280, 2, tall=5)


def people(image: Float32s, time: float) -> None:
    """Somebody in a bright vest, and somebody in dark clothes."""
    x = round(60 + 15 * time)
    image[120:150, x : x + 18] = 210
    y = round(200 - 4 * time)
    image[y : y + 40, 300:314] *= 0.3


def clock(image: Float32s, time: float) -> None:
    """A burned-in clock."""
    text = np.zeros(image.shape, np.uint8)
    cv2.putText(text, f"22:14:{time:02.0f}", (10, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 250, 1)
    image[text > 128] = 245


@pytest.mark.parametrize("more", [nothing, fixed_lamps, car, wet_ground, people, clock])
@pytest.mark.parametrize("level", [8.0, 110.0], ids=["night", "day"])
def test_the_lamp_is_found_among_other_lights(level: float, more: More) -> None:
    observations = observed(recorded(level, more))
    errors = errors_px(observations)
    shown = sum(map(is_lit, TIMES.tolist()))
    assert len(errors) > 0.85 * shown
    assert (errors < 2).mean() > 0.9
    assert np.median(errors) < 0.3
    # they are as good as they are said to be, apart from those that are wrong
    ratio = errors / observations.sigma_px[observations.camera == 0]
    assert (ratio[errors < 2] < 2.5).mean() > 0.9


def test_a_lamp_that_blinks_is_found_when_it_is_lit() -> None:
    def blinks(time: float) -> bool:
        return time % 1 < 0.5

    errors = errors_px(observed(recorded(8.0, lit=blinks)))
    assert len(errors) > 0.8 * sum(map(blinks, TIMES.tolist()))
    assert (errors < 2).mean() > 0.9


def test_a_recording_without_a_lamp_has_no_rows_and_says_so() -> None:
    dark = recorded(8.0, fixed_lamps, lit=lambda time: False)
    sightings = observe_recordings({"a": dark, "b": recorded(10)})
    assert sightings.observations.cameras == ("b",)
    assert any("a: no lamp is found" in message for message in sightings.messages)


def test_recordings_without_any_lamp_are_refused() -> None:
    dark = recorded(8.0, lit=lambda time: False)
    with pytest.raises(ValueError, match="no recording shows a lamp"):
        observe_recordings({"a": dark, "b": recorded(30.0, people, lit=lambda time: False)})


def test_a_picture_shows_the_track() -> None:
    pictures = observe_recordings({"a": recorded(8.0), "b": recorded(10)}).pictures
    image = np.asarray(cv2.imdecode(np.frombuffer(pictures["a"], np.uint8), cv2.IMREAD_COLOR))
    assert image.shape[1] == WIDTH
    # coloured where the lamp was, grey elsewhere
    colourful = (image.max(axis=2).astype(int) - image.min(axis=2)) > 80
    x, y = lamp_at(4.0)
    title_height = image.shape[0] - HEIGHT
    assert colourful[round(y) + title_height - 3 : round(y) + title_height + 4, round(x) - 3 : round(x) + 4].any()
    assert not colourful[-40:].any()
