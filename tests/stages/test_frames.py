"""A camera's captures of one night become one frame, without what is damaged and what has moved."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable

import cv2
import numpy as np
import pytest

from tests.helpers.measured import measured
from wbflow_stages.capture.files import (
    BadCapture,
    EmptyCapture,
    FeaturelessImage,
    NotAnImage,
    TruncatedImage,
    WrongSize,
    decode,
)
from wbflow_stages.capture.straight import working_size
from wbflow_stages.core.cameras import project
from wbflow_stages.frames import clean_frame
from wbflow_stages.types import Camera, Capture, Lens, Uint8s

WIDTH, HEIGHT = 320, 240


def scene(seed: int = 0, width: int = WIDTH, height: int = HEIGHT) -> np.ndarray:
    """A smooth, colourful RGB picture."""
    noise = np.random.default_rng(seed).uniform(0, 255, (12, 16, 3)).astype(np.float32)
    return np.clip(cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC), 0, 255).astype(np.uint8)


def capture(image: np.ndarray, name: str = "gate.png", extension: str | None = None) -> Capture:
    ok, data = cv2.imencode(extension or "." + name.rsplit(".", 1)[1], image[..., ::-1] if image.ndim == 3 else image)
    assert ok
    return Capture(name, data.ravel())


def test_a_single_capture_becomes_an_unchanged_rgb_frame() -> None:
    frame = clean_frame([capture(scene())], Lens(), None, resolution=None)
    assert np.array_equal(frame.image, scene())
    assert frame.mask.all() and frame.notes == ()
    assert frame.view.K is None and (frame.view.width, frame.view.height) == (WIDTH, HEIGHT)


@pytest.mark.parametrize(
    ("size", "resolution", "expected"),
    [
        ((3072, 2048), 1536, (1536, 1024)),
        ((1080, 1920), 960, (540, 960)),
        ((640, 480), 1600, (640, 480)),
        ((640, 480), None, (640, 480)),
    ],
)
def test_working_size_bounds_the_long_side_and_never_enlarges(
    size: tuple[int, int], resolution: int | None, expected: tuple[int, int]
) -> None:
    assert working_size(size[0], size[1], resolution) == expected


def test_intrinsics_follow_the_working_resolution() -> None:
    """A world point projects to the same place of the picture, whatever the resolution."""
    K = np.array([[300.0, 0, 150.2], [0, 305.0, 121.7], [0, 0, 1]])
    frame = clean_frame([capture(scene())], Lens(K=K, width=WIDTH, height=HEIGHT), None, resolution=160)
    X = np.array([[0.3, -0.2, 2.0], [-0.5, 0.1, 1.5]])
    full, _ = project(Camera(K, np.eye(3), np.zeros(3), WIDTH, HEIGHT), X)
    assert frame.view.K is not None
    small, _ = project(Camera(frame.view.K, np.eye(3), np.zeros(3), 160, 120), X)
    assert np.allclose((full + 0.5) / 2 - 0.5, small, atol=1e-9)
    assert frame.view.focal_known


def test_a_field_of_view_gives_a_guess_of_the_focal_length() -> None:
    frame = clean_frame([capture(scene())], Lens(hfov_deg=90.0), None, resolution=160)
    assert not frame.view.focal_known
    assert frame.view.K is not None
    assert frame.view.K[0, 0] == pytest.approx(80.0)
    assert frame.view.K[0, 2] == pytest.approx(79.5)


@pytest.mark.parametrize(
    ("damage", "kind", "words"),
    [
        (lambda data: data[:0], EmptyCapture, "is empty"),
        (lambda data: np.frombuffer(b"<html>not found</html>" * 40, np.uint8), NotAnImage, "a web page, not a picture"),
        (lambda data: data[:1000], TruncatedImage, r"ends after 1,000 bytes: the image is truncated"),
        (lambda data: data[: len(data) // 2], TruncatedImage, "truncated"),
    ],
)
@pytest.mark.parametrize("extension", [".jpg", ".png"])
def test_damaged_files_are_refused_with_their_name_and_fault(
    damage: Callable[[Uint8s], Uint8s], kind: type[Exception], words: str, extension: str
) -> None:
    good = capture(scene(), "gate/2026-11-19" + extension)
    with pytest.raises(kind, match=words) as caught:
        clean_frame([Capture(good.name, damage(good.data))], Lens(), None)
    assert good.name in str(caught.value)
    assert isinstance(caught.value, ValueError)


@pytest.mark.parametrize("extension", [".jpg", ".png"])
@pytest.mark.parametrize("colour", [(128, 128, 128), (60, 140, 50)])
def test_a_capture_with_an_unfinished_lower_part_is_left_out(extension: str, colour: tuple[int, int, int]) -> None:
    broken = scene()
    broken[HEIGHT // 2 :] = colour
    lost = capture(broken, "gate/1" + extension)
    with pytest.raises(TruncatedImage, match=r"gate/1.* is unfinished: the lower (4|5).* are of one colour"):
        clean_frame([lost], Lens(), None)
    whole = [capture(scene(), f"gate/{k}" + extension) for k in (2, 3)]
    assert any("unfinished" in note for note in clean_frame([lost, *whole], Lens(), None).notes)


@pytest.mark.parametrize("colour", [(0, 0, 0), (255, 255, 255)])
def test_a_letter_box_is_not_taken_for_an_unfinished_picture(colour: tuple[int, int, int]) -> None:
    boxed = scene()
    boxed[-HEIGHT // 4 :] = colour
    assert clean_frame([capture(boxed)], Lens(), None).image.shape == boxed.shape


@pytest.mark.parametrize(
    ("size", "padding", "lens", "words"),
    [
        (30_000, 0, Lens(width=WIDTH, height=HEIGHT), "has 30000 x 30000 pixels, the intrinsics are for"),
        (30_000, 10**6, Lens(), "110 million are the most"),
        (14_000, 10**6, Lens(), "as long as its intrinsics do not state its size"),
        (14_000, 0, Lens(width=14_000, height=14_000), "which .* bytes cannot hold"),
    ],
)
def test_small_jpegs_that_claim_a_huge_size_are_not_decoded(
    size: int, padding: int, lens: Lens, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cv2, "imdecode", lambda *image: pytest.fail("it is decoded"))
    good = cv2.imencode(".jpg", scene())[1].tobytes()
    at = good.index(b"\xff\xc0") + 5
    bomb = good[:at] + size.to_bytes(2, "big") * 2 + good[at + 4 :] + bytes(padding)
    with pytest.raises(BadCapture, match=words):
        decode(Capture("gate.jpg", np.frombuffer(bomb, np.uint8)), lens)


def test_a_small_png_that_claims_900_million_pixels_is_not_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "imdecode", lambda *image: pytest.fail("it is decoded"))
    good = cv2.imencode(".png", scene())[1].tobytes()
    bomb = good[:16] + (30_000).to_bytes(4, "big") * 2 + good[24:] + bytes(151_000)
    for lens, words in ((Lens(width=320, height=180), "has 30000 x 30000 pixels, the intrinsics are for"), (Lens(), "pixels")):
        with pytest.raises(BadCapture, match=words):
            decode(Capture("gate.png", np.frombuffer(bomb, np.uint8)), lens)


@pytest.mark.parametrize("bits", [1, 8])
def test_a_highly_compressed_black_picture_is_decoded_and_called_black(bits: int) -> None:
    """Black compresses to more than 1000 pixels per byte: the message calls the image black instead of too large."""
    wide, high = 4000, 3000
    body = zlib.compress((b"\0" + bytes(wide * bits // 8)) * high, 9)
    header = struct.pack(">IIBBBBB", wide, high, bits, 0, 0, 0, 0)
    chunks = [(b"IHDR", header), (b"IDAT", body), (b"IEND", b"")]
    parts = [struct.pack(">I", len(d)) + kind + d + struct.pack(">I", zlib.crc32(kind + d)) for kind, d in chunks]
    file = np.frombuffer(b"\x89PNG\r\n\x1a\n" + b"".join(parts), np.uint8)
    assert wide * high > 1000 * file.size
    with pytest.raises(FeaturelessImage, match="is black"):
        decode(Capture("gate.png", file), Lens(width=wide, height=high))


def test_the_end_of_a_thumbnail_is_not_the_end_of_the_image() -> None:
    """A truncated JPEG may contain a complete thumbnail in its EXIF segment."""
    thumbnail = capture(scene(width=64, height=48), "t.jpg").data.tobytes()
    image = capture(scene(), "gate.jpg").data.tobytes()
    with_thumbnail = image[:2] + b"\xff\xe1" + (len(thumbnail) + 2).to_bytes(2, "big") + thumbnail + image[2:]
    assert decode(Capture("gate.jpg", np.frombuffer(with_thumbnail, np.uint8))).shape == (HEIGHT, WIDTH, 3)
    with pytest.raises(TruncatedImage):
        decode(Capture("gate.jpg", np.frombuffer(with_thumbnail[: len(thumbnail) + 1500], np.uint8)))


@pytest.mark.parametrize(("level", "word"), [(3, "black"), (255, "white"), (120, "uniform")])
def test_images_without_content_are_refused_even_with_sensor_noise(level: int, word: str) -> None:
    noise = np.random.default_rng(1).normal(0, 4, (HEIGHT, WIDTH, 3))
    with pytest.raises(FeaturelessImage, match=word):
        clean_frame([capture(np.clip(level + noise, 0, 255).astype(np.uint8))], Lens(), None)


def test_a_dim_night_view_is_not_taken_for_black() -> None:
    assert clean_frame([capture((scene() * 0.08).astype(np.uint8))], Lens(), None).image.max() < 25


def test_an_unexpected_image_size_is_refused_and_both_sizes_are_named() -> None:
    lens = Lens(K=np.diag([300.0, 300.0, 1.0]), width=3072, height=2048)
    with pytest.raises(WrongSize, match=r"gate.png has 320 x 240 pixels, the intrinsics are for 3072 x 2048: "):
        clean_frame([capture(scene())], lens, None)


def test_exif_orientation_is_applied() -> None:
    jpeg = capture(scene(), "gate.jpg").data.tobytes()
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"  # orientation 6: turn clockwise
    turned = jpeg[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + jpeg[2:]
    upright = decode(Capture("gate.jpg", np.frombuffer(turned, np.uint8)))
    assert upright.shape == (WIDTH, HEIGHT, 3)
    assert np.array_equal(upright, np.rot90(decode(capture(scene(), "gate.jpg")), -1))


def test_moving_objects_and_exposure_changes_are_removed_from_the_merged_night() -> None:
    """Five captures with different exposures, and a bright van at another place in each."""
    truth = scene().astype(np.float64) * 0.6 + 20
    night = []
    for k, exposure in enumerate([1.0, 0.8, 1.15, 0.9, 1.05]):
        image = np.clip(truth * exposure, 0, 255)
        image[100:160, 50 * k : 50 * k + 60] = 250
        night.append(capture(image.astype(np.uint8), f"{k}.png"))
    frame = clean_frame(night, Lens(), None, resolution=None)
    error = np.abs(frame.image - truth * 1.0)
    assert np.percentile(error, 99) < 6  # a van differs by about 100


def test_damaged_captures_are_left_out_and_only_all_of_them_are_refused() -> None:
    good = capture(scene(), "b.png")
    bad = Capture("a.png", good.data[:500])
    frame = clean_frame([bad, good], Lens(), None, resolution=None)
    assert np.array_equal(frame.image, scene())
    assert len(frame.notes) == 1 and "a.png ends after 500 bytes" in frame.notes[0]
    with pytest.raises(BadCapture, match=r"a\.png ends after 500 bytes.*c\.png is empty"):
        clean_frame([bad, Capture("c.png", good.data[:0])], Lens(), None)
    with pytest.raises(
        BadCapture, match=r": a\.png ends after 500 bytes[^;]* \(and 1 more like it\); c\.png is empty \(0 bytes\)$"
    ):
        clean_frame([bad, Capture("b.png", good.data[:600]), Capture("c.png", good.data[:0])], Lens(), None)


def test_a_capture_of_a_different_size_is_left_out() -> None:
    night = [capture(scene(width=160, height=120), "odd.png")] + [capture(scene(), f"{k}.png") for k in range(3)]
    frame = clean_frame(night, Lens(), None, resolution=None)
    assert frame.image.shape == (HEIGHT, WIDTH, 3) and "odd.png" in frame.notes[0]


def test_only_the_later_of_two_captures_is_used() -> None:
    frame = clean_frame([capture(scene(1), "1.png"), capture(scene(2), "2.png")], Lens(), None, resolution=None)
    assert np.array_equal(frame.image, scene(2))
    assert any("only 2.png" in note for note in frame.notes)


def test_distortion_is_removed_and_its_empty_borders_are_masked() -> None:
    """Dots that are drawn where a distorting lens shows them are moved to where a pinhole shows them."""
    K = np.array([[250.0, 0, 160], [0, 250.0, 120], [0, 0, 1]])
    distortion = np.array([0.25, 0.05, 0.002, -0.003, 0.0])  # pincushion: undistorting needs pixels from outside the sensor
    rays = np.array([[x, y, 1.0] for x in (-0.4, 0.0, 0.35) for y in (-0.3, 0.02, 0.28)])
    dots = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), K, distortion)[0].reshape(-1, 2)
    yy, xx = np.mgrid[0:HEIGHT, 0:WIDTH]
    image = np.full((HEIGHT, WIDTH), 40.0)
    for x, y in dots:
        image += 200 * np.exp(-((xx - x) ** 2 + (yy - y) ** 2) / (2 * 3.0**2))
    captured = np.repeat(image[..., None], 3, axis=2).clip(0, 255).astype(np.uint8)
    frame = clean_frame([capture(captured)], Lens(K, distortion, None, WIDTH, HEIGHT), None, resolution=None)
    for x, y in (rays @ K.T)[:, :2]:
        near = np.hypot(xx - x, yy - y) < 9
        weight = (frame.image[..., 0].astype(float) - 40) * near
        assert np.hypot((weight * xx).sum() / weight.sum() - x, (weight * yy).sum() / weight.sum() - y) < 0.15
    barrel = clean_frame([capture(captured)], Lens(K, -distortion, None, WIDTH, HEIGHT), None, resolution=None)
    assert frame.mask[120, 160] and not frame.mask[0, 0]
    assert barrel.mask.all()


def test_only_nonzero_mask_pixels_are_used() -> None:
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[:, 100:] = 1  # any value but zero
    frame = clean_frame([capture(scene())], Lens(), capture(mask, "mask.png"), resolution=160)
    assert frame.mask.shape == (120, 160)
    assert not frame.mask[:, :50].any() and frame.mask[:, 51:].all()


@pytest.mark.parametrize(
    ("mask", "words"),
    [
        (capture(np.full((100, 100), 255, np.uint8), "mask.png"), "mask mask.png has 100 x 100 pixels, the captures 320 x 240"),
        (capture(np.zeros((HEIGHT, WIDTH), np.uint8), "mask.png"), "leaves no pixel"),
        (Capture("mask.png", np.zeros(0, np.uint8)), "mask mask.png is empty"),
    ],
)
def test_masks_of_a_wrong_size_without_pixels_or_without_data_are_refused(mask: Capture, words: str) -> None:
    with pytest.raises(BadCapture, match=words):
        clean_frame([capture(scene())], Lens(), mask)


def test_a_long_night_is_sampled_evenly() -> None:
    night = [capture(scene(k), f"{k}.png") for k in range(9)]
    frame = clean_frame(night, Lens(), None, resolution=None, max_captures=3)
    chosen = clean_frame([night[0], night[4], night[8]], Lens(), None, resolution=None)
    assert np.array_equal(frame.image, chosen.image)
    assert "3 of 9 captures used" in frame.notes


def test_darkness_lowers_brightness_and_defocus_lowers_sharpness() -> None:
    noise = np.random.default_rng(1).uniform(0, 255, (HEIGHT // 4, WIDTH // 4, 3)).astype(np.float32)
    image = np.clip(cv2.resize(noise, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC), 0, 255).astype(np.uint8)
    shown, dark, blurred = (
        clean_frame([capture(picture)], Lens(), None)
        for picture in (image, (image * 0.3).astype(np.uint8), cv2.GaussianBlur(image, (0, 0), 3))
    )
    assert abs(measured(dark.brightness) / measured(shown.brightness) - 0.3) < 0.01
    assert abs(measured(dark.sharpness) / measured(shown.sharpness) - 1) < 0.1
    assert measured(blurred.sharpness) < 0.5 * measured(shown.sharpness)
    assert abs(measured(blurred.brightness) / measured(shown.brightness) - 1) < 0.01


def test_masked_pixels_do_not_count_as_saturated() -> None:
    image = scene()
    image[:, : WIDTH // 2] = 255
    mask = np.full((HEIGHT, WIDTH), 255, np.uint8)
    mask[:, : WIDTH // 2] = 0
    plain, masked = (clean_frame([capture(image)], Lens(), m) for m in (None, capture(mask, "mask.png")))
    assert measured(plain.saturated) > 0.49
    assert measured(masked.saturated) < 0.1


def test_black_pixels_do_not_count_as_saturated() -> None:
    image = scene()
    image[:, : WIDTH // 2] = 0
    assert measured(clean_frame([capture(image)], Lens(), None).saturated) < 0.1
