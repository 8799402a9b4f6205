"""What obstructs the view of a camera: drops, dirt and scratches on the glass, webs, nets, branches, railings, lorries, flares.

Each function but `with_drops`, which returns one, changes one image.  Those with a generator place things at random.
"""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np

from wbflow_stages.types import Uint8s


def with_drops(share: float, seed: int) -> Callable[[Uint8s], Uint8s]:
    """Discs that show the image blurred and rotated by 180 degrees, at the same places in all images of a camera."""

    def change(image: Uint8s) -> Uint8s:
        h, w = image.shape[:2]
        rng, wet = np.random.default_rng(seed), np.zeros((h, w), np.uint8)
        while wet.mean() < share:
            cv2.circle(wet, (int(rng.uniform(0, w)), int(rng.uniform(0, h))), int(rng.uniform(0.03, 0.1) * w), 1, -1)
        seen = cv2.GaussianBlur(image[::-1, ::-1], (0, 0), 0.02 * w)
        return np.asarray(np.where(wet[..., None] > 0, seen, image), np.uint8)

    return change


def webbed(image: Uint8s) -> Uint8s:
    """A spider's web in front of the glass, out of focus."""
    h, w = image.shape[:2]
    web, middle = np.zeros((h, w), np.uint8), (w // 2, h // 3)
    for angle in np.linspace(0, 2 * np.pi, 14, endpoint=False):
        cv2.line(web, middle, (int(middle[0] + w * np.cos(angle)), int(middle[1] + w * np.sin(angle))), 255, max(w // 107, 1))
    for radius in range(w // 16, w * 5 // 8, w // 15):
        cv2.circle(web, middle, radius, 255, max(w // 160, 1))
    return _covered(image, cv2.GaussianBlur(web, (0, 0), w / 160), 0.8, (200, 200, 200))


def hidden(image: Uint8s) -> Uint8s:
    """A lorry in front of the camera hides the lower left of the image."""
    h, w = image.shape[:2]
    image = image.copy()
    image[int(0.35 * h) :, : int(0.45 * w)] = (60, 40, 35)
    return image


def barred(image: Uint8s) -> Uint8s:
    """A railing close in front of the camera."""
    image, w = image.copy(), image.shape[1]
    for x in range(w // 10, w, w // 6):
        image[:, x : x + w // 60] = 30
    return image


def netted(image: Uint8s, rng: np.random.Generator) -> Uint8s:
    """A net of thin cord, with meshes of a sixteenth of the width."""
    h, w = image.shape[:2]
    net, mesh, slope = np.zeros((h, w), np.uint8), w / rng.uniform(14, 20), rng.uniform(0.5, 1.0)
    for k in range(-60, 61):
        for side in (1, -1):
            start, end = ((int(k * mesh + sign * 2 * w), int(sign * 2 * w * side * slope)) for sign in (-1, 1))
            cv2.line(net, start, end, 255, 1)
    return _covered(image, cv2.GaussianBlur(net, (0, 0), w / 460), 0.9, (60, 60, 60))


def dirty(image: Uint8s, rng: np.random.Generator) -> Uint8s:
    """Specks on the glass, out of focus."""
    h, w = image.shape[:2]
    specks = np.zeros((h, w), np.uint8)
    for _ in range(120):
        centre = int(rng.uniform(0, w)), int(rng.uniform(0, h))
        cv2.circle(specks, centre, int(rng.uniform(w / 200, w / 60)), int(rng.uniform(120, 255)), -1)
    return _covered(image, cv2.GaussianBlur(specks, (0, 0), w / 120), 0.8, (70, 70, 70))


def scratched(image: Uint8s, rng: np.random.Generator) -> Uint8s:
    """Bright scratches on a dome."""
    h, w = image.shape[:2]
    scratches = np.zeros((h, w), np.uint8)
    for _ in range(60):
        start, angle = rng.uniform(0, 1, 2) * (w, h), rng.uniform(0, 2 * np.pi)
        end = start + rng.uniform(w / 8, w / 2) * np.array([np.cos(angle), np.sin(angle)])
        cv2.line(scratches, start.astype(int).tolist(), end.astype(int).tolist(), 255, 1)
    return _covered(image, cv2.GaussianBlur(scratches, (0, 0), w / 400), 0.98, (220, 220, 220))


def overgrown(image: Uint8s, rng: np.random.Generator) -> Uint8s:
    """Twigs with leaves that hang into the picture."""
    h, w = image.shape[:2]
    plant = np.zeros((h, w), np.uint8)
    for _ in range(4):
        at, direction = np.array([rng.uniform(0, w), 0.0]), np.array([rng.normal(0, 0.5), 1.0])
        for _ in range(60):
            following = at + direction * h / 45
            cv2.line(plant, at.astype(int).tolist(), following.astype(int).tolist(), 255, max(w // 160, 1))
            at, direction = following, direction + rng.normal(0, 0.25, 2)
            direction /= np.linalg.norm(direction)
            for leaf in at + rng.normal(0, w / 40, (2, 2)):
                size = max(w // 60, 2), max(w // 130, 1)
                cv2.ellipse(plant, leaf.astype(int).tolist(), size, rng.uniform(0, 180), 0, 360, 255, -1)
    return _covered(image, cv2.GaussianBlur(plant, (0, 0), w / 320), 1.0, (30, 55, 35))


def flared(image: Uint8s, rng: np.random.Generator) -> Uint8s:
    """Bright spots of stray light."""
    h, w = image.shape[:2]
    y, x = np.mgrid[:h, :w]
    light = np.zeros((h, w))
    for _ in range(6):
        cx, cy, size = rng.uniform(0, w), rng.uniform(0, h), rng.uniform(w / 20, w / 6)
        light += rng.uniform(0.2, 0.7) * np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / (2 * size**2))
    return _covered(image, 255 * light.clip(0, 0.85), 1.0, (245, 245, 245))


def _covered(image: Uint8s, cover: np.ndarray, opacity: float, colour: tuple[int, int, int]) -> Uint8s:
    """The image behind something of one colour; cover: (h, w), 0 to 255."""
    share = opacity * np.asarray(cover, np.float64)[..., None] / 255
    return np.asarray(np.clip(image * (1 - share) + np.array(colour) * share, 0, 255), np.uint8)
