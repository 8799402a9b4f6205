"""Keypoints are spread over the frame, avoid its mask, come in a fixed order, and have correct positions and frames."""

import numpy as np
import pytest

from wbflow_stages.features import detect
from wbflow_stages.types import PLAIN, TILTED, Features, Frame, Rejected, View


def blobs(seed: int = 0, width: int = 480, height: int = 320) -> np.ndarray:
    """A grey image of soft blobs, in which SIFT finds keypoints everywhere."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    image = np.full((height, width), 110.0)
    for cx, cy, radius, tone in zip(
        rng.uniform(0, width, 300), rng.uniform(0, height, 300), rng.uniform(2, 7, 300), rng.choice([-130, 130], 300), strict=True
    ):
        image += tone * np.exp(-0.5 * ((x - cx) ** 2 + (y - cy) ** 2) / radius**2)
    return np.asarray(np.clip(image, 0, 255))


def frame(grey: np.ndarray, mask: np.ndarray | None = None) -> Frame:
    image = np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)
    h, w = grey.shape
    return Frame(image, np.ones((h, w), bool) if mask is None else mask, View(w, h))


def features(grey: np.ndarray, mask: np.ndarray | None = None, **options: object) -> Features:
    found = detect(frame(grey, mask), **options)  # type: ignore[arg-type]
    assert isinstance(found, Features)
    return found


def test_descriptors_have_unit_length_and_arrays_have_equal_length() -> None:
    found = features(blobs())
    n = len(found.xy)
    assert found.frames.shape == (n, 2, 2) and found.responses.shape == (n,) and found.tilts.shape == (n,)
    np.testing.assert_allclose(np.linalg.norm(found.descriptors, axis=1), 1, atol=1e-5)
    assert found.plain_keypoints == np.sum(found.tilts == PLAIN)


def test_the_same_frame_gives_the_same_bytes() -> None:
    first, second = features(blobs()), features(blobs())
    for name in ("xy", "frames", "descriptors", "responses", "tilts"):
        assert getattr(first, name).tobytes() == getattr(second, name).tobytes()


def test_the_number_of_keypoints_is_limited_and_the_strongest_come_first() -> None:
    found = features(blobs(), max_keypoints=120, tilted_keypoints=40)
    assert np.sum(found.tilts == PLAIN) == 120 and np.sum(found.tilts == TILTED) <= 40
    assert (np.diff(found.responses[:120]) <= 0).all()


def test_a_large_image_searched_in_bands_gives_the_same_keypoints(monkeypatch: pytest.MonkeyPatch) -> None:
    grey = blobs(width=480, height=900)
    whole = features(grey, tilted_keypoints=0, max_keypoints=400)
    monkeypatch.setattr("wbflow_stages.matching.sift.LARGEST_PX", 160_000)
    bands = features(grey, tilted_keypoints=0, max_keypoints=400)
    same = set(map(tuple, np.round(whole.xy, 2))) & set(map(tuple, np.round(bands.xy, 2)))
    assert len(same) > 0.98 * len(whole.xy)
    assert np.ptp(bands.xy[:, 1]) > 850


def test_a_faint_half_gets_its_share_of_keypoints() -> None:
    grey = blobs()
    grey[:, 240:] = 110 + 0.15 * (grey[:, 240:] - 110)
    even = features(grey, max_keypoints=100, tilted_keypoints=0, crowding=1.0)
    strongest = features(grey, max_keypoints=100, tilted_keypoints=0, crowding=100.0)
    assert (even.xy[:, 0] > 240).sum() >= 35
    assert (strongest.xy[:, 0] > 240).sum() < 30


def test_keypoints_avoid_the_mask_and_its_border() -> None:
    mask = np.ones((320, 480), bool)
    mask[:, 200:280] = False
    found = features(np.where(mask, blobs(), 0), mask)
    inside = (found.xy[:, 0] > 199) & (found.xy[:, 0] < 280)
    assert not inside.any() and len(found.xy) > 100


@pytest.mark.parametrize(("view", "elongation"), [(PLAIN, 1.0), (TILTED, 2.0)])
def test_keypoints_lie_at_the_centres_of_their_blobs(view: Frame, elongation: float) -> None:
    y, x = np.mgrid[:300, :600]
    rng = np.random.default_rng(0)
    centres = np.array([(60 + 115 * i, 50 + 50 * j) for i in range(5) for j in range(5)]) + rng.uniform(-0.5, 0.5, (25, 2))
    sigma = 5.0
    grey = 60 + sum(120 * np.exp(-0.5 * (((x - cx) / elongation) ** 2 + (y - cy) ** 2) / sigma**2) for cx, cy in centres)
    found = features(grey, min_keypoints=5, preprocessing="none")
    xy = found.xy[found.tilts == view]
    nearest = np.linalg.norm(centres[:, None] - xy[None], axis=2).argmin(axis=1)
    offset = xy[nearest] - centres
    np.testing.assert_allclose(np.median(offset, axis=0), 0, atol=0.1)  # a shift of half a pixel would show


def test_frames_of_keypoints_turn_with_the_image() -> None:
    grey = blobs(width=320, height=320)
    upright, turned = features(grey, tilted_keypoints=0), features(np.rot90(grey, -1), tilted_keypoints=0)
    rotation = np.array([[0.0, -1.0], [1.0, 0.0]])  # clockwise: (x, y) -> (319 - y, x)
    where = upright.xy @ rotation.T + [319, 0]
    distance = np.linalg.norm(where[:, None] - turned.xy[None], axis=2)
    nearest = distance.argmin(axis=1)
    similarity = np.einsum("nd,nd->n", upright.descriptors, turned.descriptors[nearest])
    same = (distance.min(axis=1) < 0.3) & (similarity > 0.97)
    assert same.mean() > 0.6
    relative = turned.frames[nearest[same]] @ np.linalg.inv(upright.frames[same])
    assert np.median(np.abs(relative - rotation).max(axis=(1, 2))) < 0.05


def test_an_empty_frame_is_rejected_with_its_number_of_keypoints() -> None:
    found = detect(frame(np.full((200, 300), 90.0)))
    assert isinstance(found, Rejected) and found.figures["keypoints"] == 0


@pytest.mark.parametrize(("gain", "preprocessing"), [(1.0, "none"), (0.12, "clahe")])
def test_preprocessing_is_chosen_by_the_contrast_of_the_image(gain: float, preprocessing: str) -> None:
    assert features(gain * blobs(), min_keypoints=1).preprocessing == preprocessing
