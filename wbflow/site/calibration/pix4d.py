"""Pix4D's `*_calibrated_camera_parameters.txt`.

References
----------
support.pix4d.com: "What does the Output Params Folder contain?", "How are the Internal and External Camera Parameters defined?"
The file begins with lines that name its layout; then each picture has ten lines: name, width and height; K in three lines; the
radial and the tangential distortion; the camera's position; its rotation in three lines.  x ~ K R (X - position), and the
distortion is OpenCV's.
"""

from __future__ import annotations

import re

from .calibrated import Calibrated, Faulty, calibrated

_FIRST_LINE = re.compile(r"\s*fileName\s+imageWidth\s+imageHeight")
_LAYOUT = (
    *("filename imagewidth imageheight", "camera matrix k [3x3]", "radial distortion [3x1]", "tangential distortion [2x1]"),
    *("camera position t [3x1]", "camera rotation r [3x3]"),
)
"""The lines at the beginning of a file, in lower case; the line after them repeats the formula."""
_FORMULA = re.compile(r"camera model m\s*=\s*k\s*\[r\|-rt\]\s*x")
_REMEDY = "give Pix4D's calibrated_camera_parameters.txt as it was written"
_LINES_PER_PICTURE = (3, 3, 3, 3, 2, 3, 3, 3, 3)
"""How many numbers each line of a picture after its first has."""


def is_pix4d(text: str) -> bool:
    """Is this the text of a file of calibrated camera parameters?"""
    return _FIRST_LINE.match(text) is not None


def read_pix4d(text: str) -> dict[str, Calibrated]:
    """Cameras by image name.  Raises Faulty, whose location is the number of the line."""
    # 1. the lines that name the layout
    lines = [(number, line.split()) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    for expected, (number, words) in zip(_LAYOUT, lines, strict=False):
        if " ".join(words).lower() != expected:
            raise Faulty(f"says {' '.join(words)!r} where {expected!r} is expected: another layout", (number,), _REMEDY)
    at = len(_LAYOUT)
    if at < len(lines) and _FORMULA.match(" ".join(lines[at][1]).lower()):
        at += 1
    # 2. the pictures
    cameras: dict[str, Calibrated] = {}
    while at < len(lines):
        number, words = lines[at]
        name = " ".join(words[:-2])
        # a name may contain spaces: width and height are the last two words
        if len(words) < 3 or not all(word.isdigit() for word in words[-2:]) or name in cameras:
            raise Faulty("is not the first line of a picture: its name, width and height", (number,), _REMEDY)
        block = lines[at + 1 : at + 1 + len(_LINES_PER_PICTURE)]
        if len(block) < len(_LINES_PER_PICTURE):
            raise Faulty(f"{name} lacks lines: the file ends too early", (number,), _REMEDY)
        rows = []
        for count, (row_number, row) in zip(_LINES_PER_PICTURE, block, strict=True):
            if len(row) != count:
                raise Faulty(f"has {len(row)} numbers, {count} are expected here", (row_number,), _REMEDY)
            try:
                rows.append([float(word) for word in row])
            except ValueError:
                raise Faulty("must hold numbers", (row_number,), _REMEDY) from None
        k1, k2, k3 = rows[3]
        p1, p2 = rows[4]
        fields = {
            "K": rows[:3],
            "width": int(words[-2]),
            "height": int(words[-1]),
            "distortion": [k1, k2, p1, p2, k3],
            "C": rows[5],
            "R": rows[6:],
        }
        try:
            cameras[name] = calibrated(fields)
        except Faulty as fault:
            raise Faulty(f"{name}: {fault.what}", (number,), _REMEDY) from None
        at += 1 + len(_LINES_PER_PICTURE)
    return cameras
