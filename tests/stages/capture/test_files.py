"""Image files as cameras, recorders and phones write them: the same picture whatever the form of its file."""

from __future__ import annotations

import io
import struct
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from wbflow_stages.capture.files import NotAnImage, TruncatedImage, decode, decoded_mask
from wbflow_stages.capture.video import one_picture
from wbflow_stages.frames import clean_frame
from wbflow_stages.io.image_headers import SCAN, jpeg_end, jpeg_segments, read_jpeg
from wbflow_stages.types import Capture, Lens, Uint8s

HEIGHT, WIDTH = 96, 160


def scene() -> Uint8s:
    """A colourful picture without sharp edges, which lossy formats keep within a few grey levels."""
    small = np.random.default_rng(5).integers(20, 235, (6, 10, 3), np.uint8)
    return np.asarray(cv2.resize(small, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC), np.uint8)


def written(image: Image.Image, form: str, **options: Any) -> bytes:
    file = io.BytesIO()
    image.save(file, form, **options)
    return file.getvalue()


def capture(data: bytes, name: str = "gate.jpg") -> Capture:
    return Capture(name, np.frombuffer(data, np.uint8))


def difference(data: bytes, name: str = "gate.jpg") -> float:
    """Mean difference of a decoded file from the scene, grey levels."""
    return float(np.abs(decode(capture(data, name)).astype(float) - scene()).mean())


PICTURE = Image.fromarray(scene())
JPEG = written(PICTURE, "JPEG", quality=95)


@pytest.mark.parametrize(
    ("form", "mode", "options"),
    [
        ("JPEG", "RGB", {"progressive": True, "quality": 95}),
        ("JPEG", "RGB", {"subsampling": 0, "quality": 95}),
        ("JPEG", "CMYK", {"quality": 95}),
        ("PNG", "P", {}),
        ("PNG", "RGBA", {}),
        ("PNG", "RGB", {"compress_level": 0}),
        ("TIFF", "CMYK", {}),
        ("TIFF", "RGB", {"compression": "jpeg", "quality": 95}),
        ("TIFF", "RGB", {"compression": "tiff_lzw"}),
        ("TIFF", "P", {}),
        ("WEBP", "RGB", {"quality": 95}),
        ("BMP", "RGB", {}),
        ("PPM", "RGB", {}),
        ("JPEG2000", "RGB", {}),
    ],
)
@pytest.mark.parametrize("name", ["gate.jpg", "gate.png", "gate.mp4", "gate"])
def test_the_content_of_a_file_decides_not_its_name(form: str, mode: str, options: dict[str, Any], name: str) -> None:
    image = PICTURE.quantize(256) if mode == "P" else PICTURE.convert(mode)
    data = written(image, form, **options)
    shown = one_picture(capture(data, name))
    expected = np.asarray(image.convert("RGB"), float) if mode == "P" else scene().astype(float)
    assert np.abs(shown - expected).mean() < 4


def test_a_black_and_white_picture_of_one_bit_is_read() -> None:
    for form in ("PNG", "TIFF"):
        bits = PICTURE.convert("1")
        assert np.array_equal(decode(capture(written(bits, form)))[..., 0] > 0, np.asarray(bits))


def with_stray_bytes(place: int, stray: bytes) -> bytes:
    return JPEG[:place] + stray + JPEG[place:]


SEGMENTS = [start - 4 for _, start, _ in jpeg_segments(JPEG)]


@pytest.mark.parametrize("stray", [bytes(40), b"\x5a" * 513, bytes(range(1, 200))])
@pytest.mark.parametrize("place", [*SEGMENTS[1:], len(JPEG)])
def test_stray_bytes_before_a_marker_or_after_the_end_are_skipped(place: int, stray: bytes) -> None:
    data = with_stray_bytes(place, stray)
    assert difference(data) == difference(JPEG)
    notes = clean_frame([capture(data)], Lens(), None).notes
    assert any("stray bytes" in note for note in notes) == (place < len(JPEG))


@pytest.mark.parametrize("stray", [b"\r\n", b"--frame\r\nContent-Type: image/jpeg\r\n\r\n", bytes(100), b"\xff"])
def test_bytes_before_a_jpeg_are_skipped(stray: bytes) -> None:
    data = stray + JPEG
    assert difference(data) == difference(JPEG)
    assert any("stray bytes before the picture" in note for note in clean_frame([capture(data)], Lens(), None).notes)


def test_a_usual_file_has_no_notes_on_its_bytes() -> None:
    assert not [note for note in clean_frame([capture(JPEG)], Lens(), None).notes if "stray" in note]


def test_a_thumbnail_is_never_taken_for_the_picture() -> None:
    thumbnail = written(PICTURE.resize((40, 24)), "JPEG")
    body = b"Exif\0\0" + thumbnail
    segment = b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body
    whole = JPEG[:2] + segment + JPEG[2:]
    assert decode(capture(whole)).shape == (HEIGHT, WIDTH, 3)
    without_start = bytes(2) + whole[2:]
    with pytest.raises(NotAnImage):
        decode(capture(without_start))
    scan = next(start for marker, start, _ in jpeg_segments(whole) if marker == SCAN)
    with pytest.raises(TruncatedImage):
        decode(capture(whole[: scan + 200]))


@pytest.mark.parametrize("form", ["JPEG", "PNG", "TIFF", "WEBP", "BMP", "PPM", "JPEG2000"])
@pytest.mark.parametrize("share", [0.3, 0.7, 0.95])
def test_truncated_files_stay_refused(form: str, share: float) -> None:
    data = written(PICTURE, form)
    with pytest.raises((TruncatedImage, NotAnImage)):
        decode(capture(data[: int(share * len(data))]))


@pytest.mark.parametrize("share", [0.3, 0.7, 0.95])
def test_a_truncated_progressive_jpeg_stays_refused(share: float) -> None:
    data = written(PICTURE, "JPEG", progressive=True)
    with pytest.raises(TruncatedImage):
        decode(capture(data[: int(share * len(data))]))


def test_a_raw_photograph_is_named_and_its_preview_is_not_taken() -> None:
    preview = written(PICTURE.resize((40, 24)), "TIFF", tiffinfo={254: 1})
    with pytest.raises(NotAnImage, match="raw photograph"):
        decode(capture(preview, "gate.dng"))


def test_a_heic_picture_is_read_or_named_with_a_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    head = struct.pack(">I", 24) + b"ftypheic" + bytes(4) + b"mif1heic"
    monkeypatch.setitem(__import__("sys").modules, "pillow_heif", None)
    with pytest.raises(NotAnImage, match=r"HEIC.*pip install 'wbflow\[heic\]'"):
        decode(capture(head + bytes(1000), "IMG_0001.HEIC"))


def test_a_heic_picture_is_read_with_its_library() -> None:
    heif: Any = pytest.importorskip("pillow_heif")
    file = io.BytesIO()
    heif.from_pillow(PICTURE).save(file, quality=95)
    for name in ("IMG_0001.HEIC", "gate.jpg"):
        assert difference(file.getvalue(), name) < 4
    with pytest.raises(NotAnImage, match="cannot be read"):
        decode(capture(file.getvalue()[:700], "IMG_0001.HEIC"))


@pytest.mark.parametrize("white", [1, 255, 65535])
def test_a_mask_may_use_any_value_for_the_pixels_to_use(white: int) -> None:
    values = np.zeros((HEIGHT, WIDTH), np.uint16)
    values[:, 80:] = white
    mask = decoded_mask("mask.png", np.asarray(cv2.imencode(".png", values)[1], np.uint8))
    assert np.array_equal(mask > 0, values > 0)


def test_the_end_of_a_jpeg_is_found_behind_thumbnails_and_before_what_follows() -> None:
    thumbnail = b"\xff\xe1" + struct.pack(">H", len(JPEG) + 2) + JPEG
    nested = JPEG[:2] + thumbnail + JPEG[2:]
    for whole in (JPEG, nested, written(PICTURE, "JPEG", progressive=True)):
        assert jpeg_end(whole + b"\r\n--frame\r\n" + JPEG) == len(whole)
        assert jpeg_end(whole[:-1]) is None


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\r\n<html><body>Please log in</body></html>", "is a web page, not a picture: '<html><body>Please log in"),
        (b"\xff\x0a\x7f" + bytes(range(99)), "is a JPEG XL image, which is not read: have the camera write JPEG"),
        (b"PK\x03\x04" + bytes(range(99)), "is a ZIP archive"),
        (bytes(5000), "holds zeros only: its disk, or the job that copies it, has failed (5,000 bytes)"),
        (b"ordinary text", "is no image that can be read (13 bytes)"),
    ],
)
def test_what_a_file_is_that_is_no_image_is_said(data: bytes, words: str) -> None:
    with pytest.raises(NotAnImage) as caught:
        decode(capture(data, "gate.jpg"))
    assert str(caught.value).startswith("gate.jpg ") and words in str(caught.value)


@pytest.mark.parametrize("step", [1, 2, 7, 1000])
def test_a_jpeg_is_read_on_where_reading_it_has_stopped(step: int) -> None:
    thumbnail = b"\xff\xe1" + struct.pack(">H", len(JPEG) + 2) + JPEG
    whole = JPEG[:2] + thumbnail + JPEG[2:]
    offset, is_complete = 2, False
    for end in range(2, len(whole) + step, step):
        offset, is_complete = read_jpeg(whole[:end], offset)
        assert is_complete == (end >= len(whole))
    assert offset == len(whole)
