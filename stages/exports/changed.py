"""What changed, as files for people and programs: points, a list, a map, pictures before and after."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from ..types import Changes, Uint8s
from .ground import drawn, jpeg, on_the_map

_HIGHEST = 2.0
"""Differences of height of so much, in hundredths of the map's width, have the full colour."""

_SHOWN = 6
"""Pairs of pictures that the report shows."""

Columns = Mapping[str, npt.NDArray[Any]]


def changes_files(changes: Changes) -> Iterator[tuple[str, bytes | Columns]]:
    """changes.ply (as columns), changes.json, a picture of each change, and changes.tif where the site is on a map; nothing where
    there was nothing to compare with."""
    if not changes.compared:
        return
    yield "changes.ply", changes_columns(changes)
    yield "changes.json", (json.dumps(changes_told(changes), indent=1) + "\n").encode()
    for number, image in changes.crops.items():
        yield f"change-{number}.jpg", jpeg(image).tobytes()
    if changes.crs:
        layers = {"tonight's height less that of the reference, metres": changes.difference}
        yield "changes.tif", on_the_map(changes.grid, changes.difference, layers, changes.crs)


def changes_columns(changes: Changes) -> Columns:
    """Columns by name: x y z, colours, distance, sigma, significance, label (0 same, 1 new, 2 vanished, 3 unknown), blob."""
    return {
        **{name: changes.points[:, k] for k, name in enumerate(("x", "y", "z"))},
        **{name: changes.colors[:, k] for k, name in enumerate(("red", "green", "blue"))},
        "distance": changes.distance,
        "sigma": changes.sigma,
        "significance": changes.significance,
        "label": changes.label,
        "blob": changes.blob,
    }


def changes_told(changes: Changes) -> dict[str, Any]:
    """changes.json: each change with its number, and what the comparison as a whole could see."""
    rows = []
    for number, change in changes.changes.items():
        numbers = ("length", "width", "height", "area", "volume", "volume_sigma", "significance", "points")
        row: dict[str, Any] = {"number": int(number), "kind": change.kind}
        row["position"] = [round(v, 3) for v in (change.x, change.y, change.z)]
        row |= {name: round(getattr(change, name), 3) for name in numbers}
        row |= {"likeness": round(change.likeness, 3)} if change.likeness >= -1 else {}
        row |= {"cameras": change.cameras.split(",") if change.cameras else []}
        row |= {"zone": change.zone} if change.zone else {}
        row |= {"from": [round(v, 3) for v in (change.from_x, change.from_y, change.from_z)]} if change.kind == "moved" else {}
        row |= {"picture": f"change-{number}.jpg"} if number in changes.crops else {}
        rows.append(row)
    whole = {"changed_share": changes.changed_share, "unknown_share": changes.unknown_share, "noise": changes.noise}
    unit = "m" if changes.metric else "arbitrary"
    return {"unit": unit, **{name: round(value, 5) for name, value in whole.items()}, "changes": rows}


def changes_preview(changes: Changes, **_: object) -> Uint8s:
    """Differences of height from above, changes framed and numbered, and pictures before and after, as a JPEG file's bytes."""
    if not changes.compared or not changes.grid.rows:
        return jpeg(np.full((40, 480, 3), 24, np.uint8))
    known = np.isfinite(changes.difference)
    most = max(0.01 * _HIGHEST * changes.grid.cell * changes.grid.columns, 1e-9)
    share = np.clip(np.nan_to_num(changes.difference) / most, -1, 1)[..., None]
    paper, raised, lowered = (np.array(c, np.float64) for c in ((225, 225, 225), (200, 40, 30), (30, 80, 200)))
    colours = np.where(share > 0, paper + share * (raised - paper), paper - share * (lowered - paper))
    image = drawn(changes.grid, np.where(known[..., None], colours, 24).astype(np.uint8), {})
    _mark(image, changes)
    shown = [_with_number(crop, number) for number, crop in list(changes.crops.items())[:_SHOWN]]
    width = max(image.shape[1], *(crop.shape[1] for crop in shown)) if shown else image.shape[1]
    rows = [np.pad(each, ((0, 6), (0, width - each.shape[1]), (0, 0)), constant_values=24) for each in (image, *shown)]
    return jpeg(np.vstack(rows))


def _mark(image: Uint8s, changes: Changes) -> None:
    """Frame each change in a map of the grid."""
    grid, scale = changes.grid, image.shape[1] / changes.grid.columns
    for number, change in changes.changes.items():
        east, north, _ = grid.axes @ (change.x, change.y, change.z)
        x, y = (east - grid.left) / grid.cell * scale, (grid.top - north) / grid.cell * scale
        reach = max(6.0, 0.6 * np.hypot(change.length, change.width) / grid.cell * scale)
        cv2.circle(image, (round(x), round(y)), round(reach), (20, 20, 20), 2, cv2.LINE_AA)
        cv2.putText(image, number, (round(x + reach), round(y - 4)), 0, 0.6, (20, 20, 20), 2, cv2.LINE_AA)


def _with_number(crop: Uint8s, number: str) -> Uint8s:
    shown = crop.copy()
    cv2.putText(shown, number, (6, 24), 0, 0.8, (0, 0, 0), 4, cv2.LINE_AA)
    cv2.putText(shown, number, (6, 24), 0, 0.8, (255, 255, 255), 2, cv2.LINE_AA)
    return shown
