"""A walk through the demo yard: recordings of a carried lamp, with the truth."""

from __future__ import annotations

import io

import numpy as np
import pytest

from wbflow_demo import walk
from wbflow_demo.render.cameras import camera_at, choose_mounts
from wbflow_demo.render.photograph import Shots
from wbflow_demo.walk import WalkRecording, lamp_places
from wbflow_stages.core.lenses import lens_pixels
from wbflow_stages.recordings import observe_recordings
from wbflow_stages.types import Float64s, Sightings

SECONDS = 12


def short_walk(monkeypatch: pytest.MonkeyPatch, threads: int = 2) -> list[WalkRecording]:
    """Recordings of two cameras: twelve seconds in the open middle of the yard."""
    monkeypatch.setattr(walk, "SECONDS", SECONDS)
    monkeypatch.setattr(walk, "WAY", walk.WAY[-4:])
    shots = Shots(2, 1, (320, 180), threads=threads)
    return list(walk.walk_recordings(shots, 0.05, choose_mounts(2)))


def errors_px(found: Sightings, recordings: list[WalkRecording]) -> Float64s:
    """Distance of each observation from where the camera sees the lamp."""
    observed = found.observations
    errors = []
    for viewpoint in choose_mounts(2):
        (recording,) = (each for each in recordings if each.camera == viewpoint.name)
        camera, lens = camera_at(viewpoint, walk.SIZE)
        own = observed.camera == observed.cameras.index(viewpoint.name)
        places = lamp_places(observed.time[own] + recording.clock_s, recording.light)
        expected = lens_pixels(lens, (places - camera.C) @ camera.R.T)
        errors.append(np.linalg.norm(expected - observed.xy[own], axis=1))
    return np.concatenate(errors)


def test_the_lamp_is_found_where_the_truth_has_it_by_night_and_by_day(monkeypatch: pytest.MonkeyPatch) -> None:
    recordings = short_walk(monkeypatch)
    assert [each.light for each in recordings] == ["night", "night", "day", "day"]
    for light in walk.WALKS:
        of_light = [each for each in recordings if each.light == light]
        found = observe_recordings({each.camera: io.BytesIO(each.video) for each in of_light})
        errors = errors_px(found, of_light)
        # the lamp is hidden for a part of the way
        assert len(errors) > 0.5 * 2 * SECONDS * walk.FPS
        assert (errors < 2).mean() > 0.7
        assert np.median(errors) < 1


def test_the_same_walk_has_the_same_bytes_on_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walk, "FPS", 1)
    assert short_walk(monkeypatch, threads=1) == short_walk(monkeypatch, threads=2)


def test_the_lamp_is_not_carried_at_one_height() -> None:
    heights = lamp_places(np.linspace(0, walk.SECONDS, 100), "night")[:, 2]
    assert np.ptp(heights) > 1
    assert heights.min() > 1
