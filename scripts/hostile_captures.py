"""Hostile captures: a site with one camera for each of them, and two good cameras."""

from __future__ import annotations

import io
import json
import os
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

WIDE, HIGH = 320, 180
GOOD = ("good-1", "good-2")
FORMS = ("png", "jpg", "tif", "bmp")
STATED = {"fx": 300.0, "fy": 300.0, "cx": 159.5, "cy": 89.5, "width": WIDE, "height": HIGH}

Make = Callable[[Path], None]
"""Creates something at the path of a capture."""


@dataclass(frozen=True)
class Hostile:
    """A camera `name` whose capture is created by `make`."""

    name: str
    make: Make
    refused: bool = True
    reason: str = ""
    """Text that the reason of the refusal must contain."""
    stated: bool = True
    """Does the site file state the size of its captures?"""
    mask: Make | None = None


def write_site(folder: Path, cases: list[Hostile]) -> Path:
    """Write a site with a camera for each case and the good cameras; returns the site file."""
    captures = folder / "captures"
    captures.mkdir()
    cameras: list[dict[str, object]] = []
    for k, name in enumerate(GOOD):
        (captures / f"{name}.png").write_bytes(encoded(".png", k))
        cameras.append({"id": name, "intrinsics": STATED})
    for case in cases:
        case.make(captures / f"{case.name}.png")
        camera: dict[str, object] = {"id": case.name} | ({"intrinsics": STATED} if case.stated else {})
        if case.mask:
            case.mask(folder / f"mask-{case.name}.png")
            camera["mask"] = f"mask-{case.name}.png"
        cameras.append(camera)
    site = folder / "site.yaml"
    pattern = {"root": "captures", "pattern": "{camera}.*"}
    site.write_text(json.dumps({"site": "hostile", "captures": pattern, "cameras": cameras, "pin": "none"}, indent=1))
    return site


def picture(seed: int = 0, wide: int = WIDE, high: int = HIGH) -> np.ndarray:
    """(high, wide, 3) uint8 of smooth random colours: an image with texture."""
    noise = np.random.default_rng(seed).integers(0, 255, (max(high // 8, 2), max(wide // 8, 2), 3), np.uint8)
    return cv2.resize(noise, (wide, high), interpolation=cv2.INTER_CUBIC)


def encoded(form: str, seed: int = 0, wide: int = WIDE, high: int = HIGH) -> bytes:
    """The bytes of such a `picture` in an image format, such as ".png"."""
    data: bytes = cv2.imencode(form, picture(seed, wide, high))[1].tobytes()
    return data


def _video(container: str) -> bytes:
    """24 frames of such a `picture` with noise, with a key frame every 8 frames."""
    still = picture(3)
    rng = np.random.default_rng(3)
    file = io.BytesIO()
    with av.open(file, "w", format=container) as output:
        stream: Any = output.add_stream("mpeg4", rate=25)
        stream.width = WIDE
        stream.height = HIGH
        stream.gop_size = 8
        stream.bit_rate = 4_000_000
        for _ in range(24):
            noisy = np.clip(still + rng.normal(0, 3, still.shape), 0, 255).astype(np.uint8)
            output.mux(stream.encode(av.VideoFrame.from_ndarray(noisy, format="bgr24")))
        output.mux(stream.encode(None))
    return file.getvalue()


def _overwritten(data: bytes, by: bytes, begin: int | None = None) -> bytes:
    """Data with other bytes in their place, from `begin` or the middle on."""
    at = len(data) // 2 if begin is None else begin
    return data[:at] + by + data[at + len(by) :]


def png(wide: int, high: int, rows: int, bits: int = 8, colour: int = 2) -> bytes:
    """A PNG whose header states wide x high pixels, and whose data are `rows` black rows."""
    row = b"\0" + bytes(wide * bits // 8 * (3 if colour == 2 else 1)) if rows else b""
    pack = zlib.compressobj(9)
    body = b"".join(pack.compress(row) for _ in range(rows)) + pack.flush()
    chunks = [(b"IHDR", struct.pack(">IIBBBBB", wide, high, bits, colour, 0, 0, 0)), (b"IDAT", body), (b"IEND", b"")]
    parts = [struct.pack(">I", len(d)) + kind + d + struct.pack(">I", zlib.crc32(kind + d)) for kind, d in chunks]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def tiff(wide: int, high: int) -> bytes:
    """A TIFF whose header states wide x high pixels, without pixel data."""
    entries = [
        (256, 4, 1, wide),
        (257, 4, 1, high),
        (258, 3, 1, 8),
        (259, 3, 1, 1),
        (262, 3, 1, 1),
        (273, 4, 1, 8),
        (278, 4, 1, high),
    ]
    entries += [(279, 4, 1, wide * high & 0xFFFFFFFF)]
    return b"II*\0" + struct.pack("<IH", 8, len(entries)) + b"".join(struct.pack("<HHII", *e) for e in entries) + bytes(4)


def capture_cases() -> list[Hostile]:
    """All hostile captures and masks."""
    good_png, good_jpg = encoded(".png"), encoded(".jpg")
    return [
        Hostile("pipe", os.mkfifo, reason="a pipe"),
        Hostile("socket", _socket, reason="a socket"),
        Hostile("device", _link("/dev/zero"), reason="a device"),
        Hostile("device-without-end", _link("/dev/urandom"), reason="a device"),
        Hostile("folder", Path.mkdir),
        Hostile("link-to-itself", lambda p: p.symlink_to(p.name)),
        Hostile("link-to-nothing", _link("nothing")),
        Hostile("link-to-proc", _link("/proc/self/environ")),
        Hostile("link-to-memory", _link("/proc/self/mem")),
        Hostile("sparse-20-GB", _sparse(20_000_000_000), reason="20,000,000,000 bytes"),
        Hostile("sparse-200-MB", _sparse(200_000_000)),
        Hostile("empty", _bytes(b""), reason="0 bytes"),
        Hostile("one-byte", _bytes(b"x")),
        Hostile("text", _bytes(b"404 not found")),
        Hostile("html", _bytes(b"<html><body>" + b"x" * 10_000)),
        Hostile("zeros", _bytes(bytes(1_000_000))),
        Hostile("noise", _bytes(np.random.default_rng(1).bytes(1_000_000))),
        Hostile("sqlite", _bytes(b"SQLite format 3\0" + bytes(1000))),
        Hostile("zip", _bytes(b"PK\x03\x04" + bytes(1000))),
        Hostile("gzip-bomb", _bytes(zlib.compress(bytes(10_000_000)))),
        Hostile("svg", _bytes(b'<svg xmlns="http://www.w3.org/2000/svg" width="100000" height="100000"/>')),
        Hostile("png-900-Mpx", _bytes(png(30_000, 30_000, 30_000)), reason="30000"),
        Hostile("png-900-Mpx-unstated", _bytes(png(30_000, 30_000, 10)), reason="pixels", stated=False),
        Hostile("png-4-Gpx-unstated", _bytes(png(65_000, 65_000, 2)), reason="pixels", stated=False),
        Hostile("png-2-billion-wide", _bytes(png(2**31 - 1, 1, 0)), stated=False),
        Hostile("png-of-nothing", _bytes(png(0, 0, 0)), stated=False),
        Hostile("png-too-few-rows", _bytes(png(WIDE, HIGH, 3))),
        Hostile("png-16-bit-bomb", _bytes(png(20_000, 20_000, 5, bits=16)), stated=False),
        Hostile("png-black", _bytes(png(WIDE, HIGH, HIGH)), reason="black"),
        Hostile("png-12-Mpx-of-black", _bytes(png(4000, 3000, 3000, colour=0)), reason="black", stated=False),
        *(Hostile(f"{k}-other-size", _bytes(encoded(f".{k}", 2, 640, 360)), reason="640 x 360") for k in FORMS),
        Hostile("jpg-65500", _bytes(_jpeg_claims(good_jpg, 65_500, 65_500)), reason="65500"),
        Hostile("jpg-65500-unstated", _bytes(_jpeg_claims(good_jpg, 65_500, 65_500)), reason="pixels", stated=False),
        Hostile("jpg-14000-unstated", _bytes(_jpeg_claims(good_jpg, 14_000, 14_000)), reason="cannot hold", stated=False),
        Hostile("jpg-10000-padded", _bytes(_jpeg_claims(good_jpg, 10_000, 10_000) + bytes(200_000)), refused=False, stated=False),
        Hostile(
            "jpg-12000-padded", _bytes(_jpeg_claims(good_jpg, 12_000, 12_000) + bytes(200_000)), reason="state", stated=False
        ),
        Hostile("jpg-of-nothing", _bytes(_jpeg_claims(good_jpg, 0, 0)), stated=False),
        Hostile("tiff-billions", _bytes(tiff(60_000, 60_000)), reason="pixels", stated=False),
        Hostile("tiff-of-nothing", _bytes(tiff(0, 0)), stated=False),
        Hostile("tiff-loop", _bytes(b"II*\0" + struct.pack("<IH", 8, 0) + struct.pack("<I", 8)), stated=False),
        Hostile("tiff-far-away", _bytes(b"II*\0" + struct.pack("<I", 0xFFFFFFF0)), stated=False),
        Hostile("bmp-billions", _bytes(_bmp(60_000, 60_000)), reason="pixels", stated=False),
        Hostile("bmp-negative", _bytes(_bmp(-5, -5)), stated=False),
        Hostile("ppm-billions", _bytes(b"P6 60000 60000 255\n" + bytes(100)), reason="pixels", stated=False),
        Hostile("pfm-billions", _bytes(b"PF\n60000 60000\n-1.0\n" + bytes(100)), stated=False),
        Hostile("hdr-billions", _bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 60000 +X 60000\n" + bytes(100)), stated=False),
        Hostile("ras-billions", _bytes(struct.pack(">8I", 0x59A66A95, 60_000, 60_000, 24, 0, 1, 0, 0)), stated=False),
        Hostile(
            "webp-billions",
            _bytes(b"RIFF\xff\xff\xff\x00WEBPVP8X\x0a\0\0\0\0\0\0\0" + b"\xff" * 6),
            reason="pixels",
            stated=False,
        ),
        Hostile("gif", _bytes(b"GIF89a" + struct.pack("<HH", 60_000, 60_000) + bytes(100)), stated=False),
        Hostile("jp2", _bytes(b"\0\0\0\x0cjP  \r\n\x87\n" + bytes(100)), stated=False),
        Hostile("exr", _bytes(b"\x76\x2f\x31\x01\x02\0\0\0" + bytes(100)), stated=False),
        Hostile("avif", _bytes(b"\0\0\0\x20ftypavif" + bytes(100)), stated=False),
        *(Hostile(f"png-cut-{k}", _bytes(good_png[: len(good_png) * k // 6])) for k in range(1, 6)),
        *(Hostile(f"jpg-cut-{k}", _bytes(good_jpg[: len(good_jpg) * k // 6])) for k in range(1, 6)),
        *(Hostile(f"png-flipped-{k}", _bytes(_flipped(good_png, k)), refused=False) for k in range(3)),
        *(Hostile(f"jpg-flipped-{k}", _bytes(_flipped(good_jpg, k)), refused=False) for k in range(6)),
        *_video_cases(),
        *_mask_cases(good_png),
    ]


def _video_cases() -> list[Hostile]:
    stream = _video("mpegts")
    film = _video("mp4")
    packets = len(stream) // 188
    return [
        Hostile("video", _bytes(stream), refused=False),
        Hostile("video-cut", _bytes(stream[: len(stream) // 2]), refused=False),
        Hostile("video-begun-late", _bytes(stream[packets // 3 * 188 :]), refused=False),
        Hostile("video-zeros", _bytes(_overwritten(stream, bytes(3000))), refused=False),
        Hostile("video-noise", _bytes(_overwritten(stream, np.random.default_rng(2).bytes(3000))), refused=False),
        Hostile("video-lost-packets", _bytes(stream[: packets // 2 * 188] + stream[(packets // 2 + 16) * 188 :]), refused=False),
        Hostile("video-of-zeros", _bytes(_overwritten(stream, bytes(len(stream) - 2000), 1000)), reason="no video"),
        Hostile("film-zeros", _bytes(_overwritten(film, bytes(3000))), refused=False),
        Hostile("film-cut", _bytes(film[: len(film) // 2]), reason="no video"),
        Hostile("playlist", _bytes(b"#EXTM3U\n#EXT-X-TARGETDURATION:5\n#EXTINF:5,\nfile:///etc/passwd\n#EXT-X-ENDLIST\n")),
    ]


def _mask_cases(good_png: bytes) -> list[Hostile]:
    return [
        Hostile("mask-sparse", _bytes(good_png), mask=_sparse(20_000_000_000), reason="20,000,000,000 bytes"),
        Hostile("mask-empty", _bytes(good_png), mask=_bytes(b""), reason="0 bytes"),
        Hostile("mask-text", _bytes(good_png), mask=_bytes(b"no mask"), reason="mask"),
        Hostile("mask-900-Mpx", _bytes(good_png), mask=_bytes(png(30_000, 30_000, 10)), reason="mask"),
        Hostile("mask-black", _bytes(good_png), mask=_bytes(png(WIDE, HIGH, HIGH)), reason="no pixel"),
    ]


def _bytes(data: bytes) -> Make:
    def make(path: Path) -> None:
        path.write_bytes(data)

    return make


def _sparse(size: int) -> Make:
    def make(path: Path) -> None:
        path.touch()
        os.truncate(path, size)

    return make


def _link(target: str) -> Make:
    return lambda path: path.symlink_to(target)


def _socket(path: Path) -> None:
    import socket

    here = Path.cwd()
    with socket.socket(socket.AF_UNIX) as bound:
        os.chdir(path.parent)  # the path of a socket has at most 108 bytes
        try:
            bound.bind(path.name)
        finally:
            os.chdir(here)


def _jpeg_claims(data: bytes, wide: int, high: int) -> bytes:
    """A JPEG whose frame header is changed to another size."""
    at = data.index(b"\xff\xc0") + 5
    return data[:at] + struct.pack(">HH", high, wide) + data[at + 4 :]


def _bmp(wide: int, high: int) -> bytes:
    return b"BM" + struct.pack("<IHHIIiiHHIIiiII", 154, 0, 0, 54, 40, wide, high, 1, 24, 0, 0, 0, 0, 0, 0) + bytes(100)


def _flipped(data: bytes, seed: int) -> bytes:
    changed = bytearray(data)
    for at in np.random.default_rng(seed).integers(20, len(data), 5):
        changed[at] ^= 0x10
    return bytes(changed)
