"""No file below the work folder contains pixels of a `privacy:` polygon: later stages take their colours from masked frames."""

from __future__ import annotations

import base64
import dataclasses
import re
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest

import wbflow
from tests.helpers.images import decoded
from tests.helpers.synthetic_site import small_yard
from wbflow.cache import artifact
from wbflow.cache.ply import read_ply

CORNERS = ((20, 60), (150, 50), (140, 175), (10, 170))
"""Corners of the privacy polygon, in captures of 320 x 180 pixels: a piece of the ground that both cameras see."""
PLANTED = ((24, 64), (146, 54), (136, 171), (14, 166))
"""Corners of the planted pattern, which lies inside the privacy polygon."""


SECRET = ((255, 0, 255), (0, 255, 0))
ANOTHER = ((10, 30, 40), (250, 250, 0))
"""`SECRET` and `ANOTHER` are two choices for the colours (RGB) of the planted squares."""

Colour = tuple[int, int, int]
PICTURE = re.compile(r"data:image/\w+;base64,([\w+/=]+)")
"""A picture in a report; the group is its data in base64."""


def site_with_a_secret(folder: Path, private: bool, colours: tuple[Colour, Colour] = SECRET) -> Path:
    """Write a site with two cameras of the yard; its captures get squares in colours that the yard does not have."""
    (folder / "in").mkdir(parents=True, exist_ok=True)
    rows = []
    for camera in small_yard().cameras[1:3]:
        for k, picture in enumerate(camera.captures):
            image = picture.copy()
            inside = cv2.fillPoly(np.zeros(image.shape[:2], np.uint8), [np.array(PLANTED)], 1)
            y, x = np.nonzero(inside)
            image[y, x] = np.where(((x // 9 + y // 9) % 2)[:, None] == 1, *colours)
            cv2.imwrite(str(folder / "in" / f"{camera.name}_{k}.png"), image[..., ::-1])
        K, R, C = (np.asarray(v).tolist() for v in (camera.lens.K, camera.camera.R, camera.camera.C))
        lens = f"intrinsics: {{fx: {K[0][0]}, fy: {K[1][1]}, cx: {K[0][2]}, cy: {K[1][2]}, width: 320, height: 180}}"
        polygon = f", privacy: [{[list(corner) for corner in CORNERS]}]" if private else ""
        pose = f"pose: {{position: {C}, rotation: {R}}}"
        rows.append(f"  - {{id: {camera.name}, {lens}, distortion: {camera.lens.distortion.tolist()}, {pose}{polygon}}}")
    text = "site: secret\ncaptures: {root: in, pattern: '{camera}_*.png'}\nresolution: null\ncameras:\n" + "\n".join(rows)
    (folder / "site.yaml").write_text(text + "\npin: none\nstages: {refine: false}\n")
    return folder / "site.yaml"


def secret_share(pixels: npt.NDArray[np.uint8]) -> float:
    """Share of pixels (..., 3) that have a colour of the planted squares (`SECRET`)."""
    colours = pixels.reshape(-1, 3).astype(int)
    outer, green = np.minimum(colours[:, 0], colours[:, 2]), colours[:, 1]
    purple, pure = outer - green > 110, green - np.maximum(colours[:, 0], colours[:, 2]) > 110
    return float((purple | pure).mean()) if len(colours) else 0.0


def pictures_below(folder: Path) -> Iterator[tuple[str, npt.NDArray[np.uint8]]]:
    """Yield name and colours of all pictures, pictures within reports, colour arrays of artifacts, and clouds below a folder."""
    for file in sorted(p for p in folder.rglob("*") if p.is_file() and not p.is_symlink()):
        if file.suffix in {".jpg", ".png"}:
            yield str(file), decoded(file.read_bytes())
        elif file.suffix == ".html":
            for data in PICTURE.findall(file.read_text()):
                yield str(file), decoded(base64.b64decode(data))
        elif file.suffix == ".ply":
            table = read_ply(file)
            yield str(file), np.stack([table[name] for name in ("red", "green", "blue")], axis=1)
        elif file.suffix == ".wbf":
            result = artifact.decode(file.read_bytes())
            for field in dataclasses.fields(result):
                value = getattr(result, field.name)
                if isinstance(value, np.ndarray) and value.dtype == np.uint8 and value.shape[-1:] == (3,):
                    yield f"{file} {field.name}", value


@pytest.mark.parametrize("private", [True, False], ids=["private", "open"])
def test_private_pixels_are_in_no_picture_artifact_or_report(tmp_path: Path, private: bool) -> None:
    site = site_with_a_secret(tmp_path, private)
    run = wbflow.run(site, jobs=1, backend="threading", until="features")
    found = dict(pictures_below(tmp_path / ".wbflow"))
    if private:
        assert all(camera.ok for camera in run.record.cameras), run.record.cameras
        assert {Path(name.split(" ")[0]).suffix for name in found} >= {".jpg", ".wbf"}
        assert {name: share for name, pixels in found.items() if (share := secret_share(pixels)) > 0} == {}
    else:
        assert any(secret_share(pixels) > 0.1 for pixels in found.values()), "it can be found where it is"


def test_no_product_of_a_night_depends_on_private_pixels(tmp_path: Path) -> None:
    """With other colours in the polygon, all frames and so all products of the night have the same bytes.  This is stronger than
    a search for the colours, which drawn lines and colour maps contain, too."""
    first = wbflow.run(site_with_a_secret(tmp_path, True, SECRET), jobs=1, backend="threading")
    assert first.record.cloud is not None, first.record.reason
    pictures = PICTURE.findall(first.run_folder.paths.report.read_text())
    second = wbflow.run(site_with_a_secret(tmp_path, True, ANOTHER), jobs=1, backend="threading")
    assert {task.stage for task, event in second.task_events.items() if event.outcome == "ran"} == {"frames"}
    one, two = first.run_folder.paths, second.run_folder.paths
    with_times = {one.record.name, one.log.name, one.report.name, one.metrics.name}
    folders = [paths.cloud.parent for paths in (one, two)]
    published = [{p.name: p.read_bytes() for p in folder.iterdir() if p.name not in with_times} for folder in folders]
    assert published[0].keys() >= {"cloud.ply", "coverage.png"}
    assert published[0] == published[1]
    assert secret_share(dict(pictures_below(folders[0]))[str(one.cloud)]) == 0
    assert pictures and PICTURE.findall(two.report.read_text()) == pictures
