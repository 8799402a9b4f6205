"""Small videos from pictures in memory."""

from __future__ import annotations

import io
from collections.abc import Sequence
from fractions import Fraction

import av

from wbflow_stages.types import Uint8s


def video(frames: Sequence[Uint8s], fps: int = 5, crf: int = 12) -> io.BytesIO:
    """An H.264 file in MP4 of frames (h, w, 3) uint8 RGB of even size.  crf: of x264, smaller is better."""
    file = io.BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=Fraction(fps), options={"crf": str(crf), "preset": "veryfast"})
        stream.pix_fmt = "yuv420p"
        stream.thread_count = 1
        stream.height, stream.width = frames[0].shape[:2]
        for image in frames:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    file.seek(0)
    return file
