"""Images taken from videos."""

from __future__ import annotations

import functools
import io
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from tests.helpers.measured import measured
from wbflow_stages.capture.files import BadCapture
from wbflow_stages.capture.video import DamagedVideo, one_picture, pictures
from wbflow_stages.frames import clean_frame
from wbflow_stages.types import Capture, Lens, Uint8s

SIZE = (160, 96)


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    """60 frames of a still scene through which a dark object moves."""
    file = tmp_path_factory.mktemp("video") / "gate.avi"
    still = cv2.resize(np.random.default_rng(0).integers(60, 220, (8, 12, 3), np.uint8), SIZE, interpolation=cv2.INTER_CUBIC)
    writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*"MJPG"), 25, SIZE)
    assert writer.isOpened()
    for k in range(60):
        frame = still.copy()
        frame[40:60, 2 * k : 2 * k + 20] = 0
        writer.write(frame)
    writer.release()
    return Capture("gate.avi", np.fromfile(file, np.uint8))


def test_every_nth_video_frame_is_taken_up_to_a_maximum(video: Capture) -> None:
    assert [name for name, _ in pictures(video, 25, 15)] == ["gate.avi frame 0", "gate.avi frame 25", "gate.avi frame 50"]
    spread = [name for name, _ in pictures(video, 1, 4)]
    assert len(spread) == 4 and spread[-1] == "gate.avi frame 45"
    assert one_picture(video).shape == (96, 160, 3)


def test_an_object_that_moves_through_a_video_is_removed(video: Capture) -> None:
    frame = clean_frame([video], Lens(), None, video_step=5)
    assert frame.image[40:60].min() > 30
    assert frame.frames_used == 12


def test_a_file_that_is_not_a_video_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(BadCapture, match=r"gate\.mp4 is no video"):
        clean_frame([Capture("gate.mp4", np.arange(200, dtype=np.uint8))], Lens(), None)
    with pytest.raises(BadCapture, match="empty"):
        clean_frame([Capture("gate.mp4", np.zeros(0, np.uint8))], Lens(), None)


FRAMES = 48


def sent() -> list[Uint8s]:
    """What a camera sends: a scene with noise, through which an object moves."""
    rng = np.random.default_rng(1)
    still = cv2.resize(rng.integers(60, 220, (8, 12, 3), np.uint8), (320, 192), interpolation=cv2.INTER_CUBIC)
    frames = []
    for k in range(FRAMES):
        frame = still + rng.normal(0, 3, still.shape)
        frame[60:120, 4 * k : 4 * k + 40] = 20
        frames.append(np.clip(frame, 0, 255).astype(np.uint8))
    return frames


SENT = sent()
SMALL = np.array(SENT, np.float32)[:, ::4, ::4]


def coded(container: str, codec: str, **options: str) -> bytes:
    """The frames as a video with a key frame every 12 frames."""
    return _coded(container, codec, tuple(options.items()))


@functools.cache
def _coded(container: str, codec: str, options: tuple[tuple[str, str], ...]) -> bytes:
    file = io.BytesIO()
    with av.open(file, "w", format=container) as output:
        stream: Any = output.add_stream(codec, rate=25, options=dict(options))
        stream.width, stream.height, stream.gop_size, stream.bit_rate = 320, 192, 12, 2_000_000
        stream.codec_context.thread_count = 1
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        for k, image in enumerate(SENT):
            frame = av.VideoFrame.from_ndarray(image, format="rgb24")
            frame.pts = k
            output.mux(stream.encode(frame))
        output.mux(stream.encode(None))
    return file.getvalue()


@dataclass
class Shown:
    """Pictures taken from a video: how far each is from what the camera sent, in mean grey levels, and its worst 16 px cell."""

    distances: list[float]
    cells: list[float]
    is_damaged: bool = False


def shown(data: bytes) -> Shown:
    """What is taken from a video, and was damage reported?  Raises BadCapture if nothing is taken."""
    result = Shown([], [])
    try:
        for _, image in pictures(Capture("gate.mp4", np.frombuffer(data, np.uint8)), 1, 1000):
            distances = np.abs(SMALL - image[::4, ::4]).mean(axis=(1, 2, 3))
            nearest = np.abs(SENT[distances.argmin()].astype(np.float32) - image).mean(axis=2)
            result.distances.append(float(distances.min()))
            result.cells.append(float(nearest.reshape(12, 16, 20, 16).mean(axis=(1, 3)).max()))
    except DamagedVideo:
        result.is_damaged = True
    return result


def assert_as_sent(result: Shown) -> None:
    assert all(distance < 6 for distance in result.distances)
    assert all(cell < 12 for cell in result.cells)


# these encoders give the same bytes each time only without a macroblock tree, and at a fixed quantizer
H264 = {"x264-params": "mbtree=0"}
H265 = {"x265-params": "log-level=none:qp=20"}
INTERLACED = {"flags": "+ilme+ildct"}
KINDS = [
    ("mp4", "libx264", H264),
    ("mp4", "libx264", {"x264-params": "mbtree=0:open-gop=1"}),
    ("mp4", "libx264", H264 | INTERLACED),
    ("mpegts", "libx264", H264 | INTERLACED),
    ("h264", "libx264", H264),
    ("mpegts", "mpeg2video", INTERLACED),
    ("mpeg", "mpeg2video", {}),
    ("avi", "mpeg4", {}),
    ("avi", "mjpeg", {}),
    ("mpegts", "libx265", H265),
    ("matroska", "libx265", H265),
]


@pytest.mark.parametrize(("container", "codec", "options"), KINDS)
def test_all_frames_are_those_that_the_camera_sent(container: str, codec: str, options: dict[str, str]) -> None:
    result = shown(coded(container, codec, **options))
    assert len(result.distances) == FRAMES and not result.is_damaged
    assert_as_sent(result)


@pytest.mark.parametrize(("container", "codec", "options"), KINDS)
@pytest.mark.parametrize("kind", ["lost", "few lost", "missing", "cut", "begun late"])
def test_no_frame_is_shown_that_the_camera_did_not_send(
    container: str, codec: str, options: dict[str, str], kind: str, request: pytest.FixtureRequest
) -> None:
    if container == "h264" and kind == "missing":
        reason = "what is left of a slice reads as another picture; no container, no check sums"
        request.applymarker(pytest.mark.xfail(strict=True, reason=reason))
    whole = coded(container, codec, **options)
    if container == "mp4" and kind in {"missing", "cut", "begun late"}:
        pytest.skip("without its index, which lies at the end, such a file cannot be opened")
    for part in (0.4, 0.5, 0.65):
        data = bytearray(whole)
        place = int(part * len(data))
        if kind == "lost":
            data[place : place + 3000] = bytes(3000)
        elif kind == "few lost":
            data[place : place + 300] = bytes(300)
        elif kind == "missing":
            del data[place : place + 3000]
        elif kind == "cut":
            del data[place:]
        else:
            del data[:place]
        try:
            assert_as_sent(shown(bytes(data)))
        except BadCapture:  # nothing can be shown
            continue


@pytest.mark.parametrize("kind", ["missing", "few missing", "overwritten"])
def test_no_frame_is_shown_from_a_matroska_file_of_h265_that_is_damaged(kind: str) -> None:
    """FFmpeg passes over lost parts of such a file, and over lost references, without a word."""
    whole = coded("matroska", "libx265", **H265)
    length = 300 if kind == "few missing" else 3000
    for part in (0.3, 0.4, 0.5, 0.6, 0.7):
        place = int(part * len(whole))
        put = np.random.default_rng(place).bytes(length) if kind == "overwritten" else b""
        result = shown(whole[:place] + put + whole[place + length :])
        assert result.is_damaged and len(result.distances) >= 12, "the other stretches are shown"
        assert_as_sent(result)


def flipped(data: bytes, places: Iterable[int]) -> bytes:
    """Data with a wrong bit at each of some places."""
    changed = bytearray(data)
    for place in places:
        changed[place] ^= 0x10
    return bytes(changed)


def without_check_sums(*kind: Any) -> Any:
    """A kind of video in which a wrong bit may read as another picture that is as good: it has no check sums."""
    return pytest.param(*kind, marks=pytest.mark.xfail(strict=True, reason="a wrong bit reads as another picture; no check sums"))


@pytest.mark.parametrize(
    ("container", "codec", "options"),
    [KINDS[0], without_check_sums(*KINDS[1]), *KINDS[2:9], without_check_sums(*KINDS[9]), KINDS[10]],
)
def test_no_frame_is_shown_that_wrong_bits_have_changed(container: str, codec: str, options: dict[str, str]) -> None:
    data = coded(container, codec, **options)
    result = shown(flipped(data, np.random.default_rng(2).integers(8000, len(data) - 8000, 6)))
    assert all(distance < 6 for distance in result.distances)


@pytest.mark.parametrize(
    ("container", "codec", "options"),
    [without_check_sums(*kind) for kind in (KINDS[0], KINDS[8], KINDS[9])],
    ids=lambda v: str(v),
)
def test_no_cell_is_shown_that_a_wrong_bit_has_changed(container: str, codec: str, options: dict[str, str]) -> None:
    data = coded(container, codec, **options)
    for place in np.random.default_rng(3).integers(8000, len(data) - 8000, 24):
        assert_as_sent(shown(flipped(data, [place])))


@pytest.mark.parametrize(("container", "codec", "options"), [KINDS[3], KINDS[5], KINDS[9]])
def test_frames_from_the_first_key_frame_on_are_used_without_a_word_if_a_recording_begins_late(
    container: str, codec: str, options: dict[str, str]
) -> None:
    whole = coded(container, codec, **options)
    result = shown(whole[len(whole) * 3 // 8 // 188 * 188 :])
    assert not result.is_damaged
    assert len(result.distances) >= 24
    assert_as_sent(result)


def test_a_transport_stream_that_lacks_packets_shows_only_what_was_sent() -> None:
    whole = coded("mpegts", "libx265", **H265)
    for packet in range(60, 340, 20):
        data = bytearray(whole)
        del data[188 * packet : 188 * (packet + 3)]
        result = shown(bytes(data))
        assert result.is_damaged
        assert_as_sent(result)


def test_only_the_last_frames_of_a_file_that_is_cut_off_are_lost() -> None:
    whole = coded("avi", "mpeg4")
    result = shown(whole[: 4 * len(whole) // 10])
    assert result.is_damaged
    assert 14 <= len(result.distances) <= 19
    assert_as_sent(result)


@pytest.mark.parametrize("intervals", [[1] * 60, [1, 7, 2, 30, 1, 1] * 10])
def test_an_undamaged_video_of_one_key_frame_keeps_all_frames_at_any_rate(intervals: list[int]) -> None:
    file = io.BytesIO()
    with av.open(file, "w", format="matroska") as output:
        stream: Any = output.add_stream("libx264", rate=25, options=H264)
        stream.width, stream.height, stream.gop_size, stream.pix_fmt = 320, 192, 250, "yuv420p"
        for k, time in enumerate(np.cumsum(intervals)):
            frame = av.VideoFrame.from_ndarray(SENT[k % FRAMES], format="rgb24")
            frame.pts = int(time)
            output.mux(stream.encode(frame))
        output.mux(stream.encode(None))
    result = shown(file.getvalue())
    assert len(result.distances) == 60 and not result.is_damaged
    assert max(result.distances) < 8


def test_damage_is_noted_and_the_sound_frames_are_used() -> None:
    data = bytearray(coded("mp4", "libx264"))
    data[len(data) // 2 : len(data) // 2 + 3000] = bytes(3000)
    frame = clean_frame([Capture("gate.mp4", np.frombuffer(bytes(data), np.uint8))], Lens(), None, video_step=5)
    assert any("gate.mp4 is damaged" in note and "not used" in note for note in frame.notes)
    assert measured(frame.frames_used) >= 5


def test_a_truncated_mp4_is_refused() -> None:
    data = coded("mp4", "libx264")
    with pytest.raises(BadCapture, match="no video that can be read"):
        shown(data[: 6 * len(data) // 10])


@pytest.mark.parametrize(("matrix", "quarter_turns"), [((0, 1, -1, 0), 3), ((-1, 0, 0, -1), 2), ((0, -1, 1, 0), 1)])
def test_a_turned_video_is_shown_upright(matrix: tuple[int, int, int, int], quarter_turns: int) -> None:
    data = coded("mp4", "libx264")
    a, b, c, d = (65536 * value for value in matrix)
    place = data.index(b"tkhd") + 44
    turned = data[:place] + struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30) + data[place + 36 :]
    plain, upright = (one_picture(Capture("gate.mp4", np.frombuffer(file, np.uint8))) for file in (data, turned))
    assert np.array_equal(upright, np.rot90(plain, quarter_turns))


@pytest.mark.parametrize("name", ["gate.jpg", "gate", "gate.dav"])
def test_a_video_with_the_name_of_a_picture_is_read_as_a_video(name: str) -> None:
    for data in (coded("mp4", "libx264"), coded("avi", "mjpeg"), coded("mpegts", "libx264"), coded("matroska", "libx264")):
        assert np.abs(one_picture(Capture(name, np.frombuffer(data, np.uint8))).astype(float) - SENT[0]).mean() < 6


def test_a_playlist_opens_no_other_file(tmp_path: Path) -> None:
    (tmp_path / "secret.ts").write_bytes(coded("mpegts", "libx264"))
    playlist = f"#EXTM3U\n#EXT-X-TARGETDURATION:5\n#EXTINF:5,\nfile://{tmp_path}/secret.ts\n#EXT-X-ENDLIST\n"
    concat = f"ffconcat version 1.0\nfile {tmp_path}/secret.ts\n"
    for text in (playlist, concat):
        with pytest.raises(BadCapture):
            one_picture(Capture("gate.mp4", np.frombuffer(text.encode(), np.uint8)))
