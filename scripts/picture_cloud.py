"""Draw a cloud as seen from a point.    picture_cloud.py CLOUD.ply OUT.jpg --eye X Y Z --target X Y Z [--width N]"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from wbflow.cache.ply import read_ply
from wbflow.site.calibration.calibrated import look_at


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cloud", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--eye", type=float, nargs=3, required=True)
    parser.add_argument("--target", type=float, nargs=3, required=True)
    parser.add_argument("--width", type=int, default=1200)
    arguments = parser.parse_args()
    table = read_ply(arguments.cloud)
    points = np.stack([table[axis] for axis in "xyz"], axis=1).astype(np.float64)
    colors = np.stack([table[c] for c in ("blue", "green", "red")], axis=1)
    image = render(
        points, colors, np.array(arguments.eye), np.array(look_at(arguments.eye, arguments.target)), arguments.width * 2
    )
    small = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(arguments.out), small, [cv2.IMWRITE_JPEG_QUALITY, 82])


def render(points: np.ndarray, colors: np.ndarray, eye: np.ndarray, R: np.ndarray, width: int) -> np.ndarray:
    """(h, w, 3) uint8 image in BGR order: each point is a small square, near points cover far ones."""
    height, focal = width * 9 // 16, 0.9 * width
    x = (points - eye) @ R.T
    x, colors = x[x[:, 2] > 0.5], colors[x[:, 2] > 0.5]
    order = np.argsort(-x[:, 2], kind="stable")
    x, colors = x[order], colors[order]
    u = np.round(focal * x[:, 0] / x[:, 2] + width / 2).astype(int)
    v = np.round(focal * x[:, 1] / x[:, 2] + height / 2).astype(int)
    image = np.full((height, width, 3), 24, np.uint8)
    for dy in range(-1, 3):
        for dx in range(-1, 3):
            inside = (u + dx >= 0) & (u + dx < width) & (v + dy >= 0) & (v + dy < height)
            image[v[inside] + dy, u[inside] + dx] = colors[inside]
    return image


if __name__ == "__main__":
    main()
