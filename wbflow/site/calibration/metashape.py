"""Cameras that Agisoft Metashape exports as XML (File > Export > Export Cameras).

References
----------
Metashape Professional User Manual, appendix "Camera models"; Python API: Camera.transform, Calibration
A camera's transform is 4x4, from its axes (x right, y down, z forward) to those of its chunk or component; that one's transform
(rotation, translation, scale) leads to the world.  The principal point is counted from the middle of the picture, and the middle
of the first pixel is at (0.5, 0.5).
"""

from __future__ import annotations

from typing import Any

from .calibrated import Calibrated, Faulty, Matrix, Vector, calibrated, product, rotation_fault, turned
from .pose import turned_axes
from .values import rows_of
from .xml_tree import Element

_REMEDY = "export the cameras from Metashape again, in local coordinates"
_COEFFICIENTS = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
_CALIBRATION_KEYS = {*_COEFFICIENTS, "resolution", "date"}
_SENSOR_KEYS = {
    *("resolution", "calibration", "covariance", "property", "bands", "data_type", "black_level", "sensitivity", "vignetting"),
    *("pixel_width", "pixel_height", "focal_length", "fixed", "film_camera", "layer_index", "meta"),
}
"""Elements of a sensor; those besides resolution and calibration say nothing about its lens."""
_CAMERA_KEYS = {
    *("transform", "orientation", "reference", "rotation_covariance", "location_covariance", "meta", "brightness"),
}
"""Elements of a camera; the reference holds what a receiver measured, which the transform already contains."""


def is_metashape(root: Element) -> bool:
    """Is this the root of an export of cameras?"""
    return root.tag == "document" and root.find("chunk", "cameras") is not None


def read_metashape(root: Element) -> dict[str, Calibrated]:
    """Cameras by label.  A camera that was not aligned has a lens and no pose.  Raises Faulty, whose location is a line."""
    cameras: dict[str, Calibrated] = {}
    for chunk in root.all("chunk"):
        # sensors and components are named by ids, which are of their chunk alone
        lenses: dict[str, dict[str, Any]] = {}
        for sensor in chunk.all("sensors", "sensor"):
            lens = _lens(sensor)
            if lens:
                lenses[sensor.attributes.get("id", "")] = lens
        worlds = {component.attributes.get("id", ""): component for component in chunk.all("components", "component")}
        for camera in [*chunk.all("cameras", "camera"), *chunk.all("cameras", "group", "camera")]:
            label = camera.attributes.get("label", "")
            sensor_id = camera.attributes.get("sensor_id", "")
            if not label or label in cameras:
                raise Faulty(f"two cameras have the label {label!r}", (camera.line,), "give each camera its own label")
            if sensor_id not in lenses:
                raise Faulty(f"camera {label} has no calibrated sensor", (camera.line,), _REMEDY)
            _refuse_unknown(camera, _CAMERA_KEYS)
            _refuse_turned(camera, label)
            world = worlds.get(camera.attributes.get("component_id", ""), chunk)
            pose = _pose(camera, world, chunk)
            cameras[label] = calibrated({**lenses[sensor_id], **pose})
    return cameras


def _refuse_turned(camera: Element, label: str) -> None:
    """Refuse a camera whose pictures were turned by their EXIF orientation: its calibration is of the unturned picture."""
    orientation = camera.find("orientation")
    if orientation is not None and orientation.text.strip() not in {"", "1"}:
        what = f"the pictures of camera {label} were turned (orientation {orientation.text.strip()}), its calibration was not"
        raise Faulty(what, (orientation.line,), "turn the pictures upright before they are aligned")


def _lens(sensor: Element) -> dict[str, Any]:
    """The lens of a sensor, from its adjusted calibration, else from its initial one; {} if it has none.

    Metashape's p1 and p2 are OpenCV's p2 and p1; b1 is added to the horizontal focal length, b2 is the skew.
    """
    _refuse_unknown(sensor, _SENSOR_KEYS)
    calibrations = list(sensor.all("calibration"))
    if not calibrations:
        return {}
    calibration = calibrations[0]
    for element in calibrations:
        if element.attributes.get("class") == "adjusted":
            calibration = element
            break
    if any(_is_film(element) for element in sensor.children):
        what = "is a film camera, whose calibration is of the scans as its fiducial marks place them"
        raise Faulty(what, (sensor.line,), "use the pictures of a digital camera")
    if "master_id" in sensor.attributes:
        raise Faulty("is a sensor of a multi-camera system, which is not read", (sensor.line,), _REMEDY)
    kind = calibration.attributes.get("type", sensor.attributes.get("type", "frame"))
    if kind not in {"frame", "fisheye"}:
        raise Faulty(f"is a {kind} sensor, which is not read; frame and fisheye are", (calibration.line,), _REMEDY)
    _refuse_unknown(calibration, _CALIBRATION_KEYS)
    # what the export leaves out is 0
    value = dict.fromkeys(_COEFFICIENTS, 0.0)
    for element in calibration.children:
        if element.tag in value:
            value[element.tag] = _numbers(element, 1)[0]
    resolution = calibration.find("resolution") or sensor.find("resolution")
    try:
        assert resolution is not None
        width = int(resolution.attributes["width"])
        height = int(resolution.attributes["height"])
    except (AssertionError, KeyError, ValueError):
        raise Faulty("lacks the width and height of the pictures", (calibration.line,), _REMEDY) from None
    if kind == "fisheye":
        model = "fisheye"
        unsupported = ["p1", "p2", "p3", "p4"]
        distortion = [value["k1"], value["k2"], value["k3"], value["k4"]]
    else:
        model = "brown"
        unsupported = ["k4", "p3", "p4"]
        # OpenCV's order, with p1 and p2 exchanged
        distortion = [value["k1"], value["k2"], value["p2"], value["p1"], value["k3"]]
    for name in unsupported:
        if value[name]:
            remedy = f"align without fitting {', '.join(unsupported)}"
            raise Faulty(f"{name} is {value[name]:g}, and this coefficient is not read", (calibration.line,), remedy)
    # counted from the middle of the picture; the middle of the first pixel is 0, 0 here and 0.5, 0.5 there
    cx = width / 2 + value["cx"] - 0.5
    cy = height / 2 + value["cy"] - 0.5
    K = [[value["f"] + value["b1"], value["b2"], cx], [0.0, value["f"], cy], [0.0, 0.0, 1.0]]
    fields = {"K": K, "width": width, "height": height, "distortion": distortion, "model": model}
    try:
        calibrated(fields)
    except Faulty as fault:
        raise Faulty(fault.what, (calibration.line,), _REMEDY) from None
    return fields


def _is_film(element: Element) -> bool:
    """Does this element of a sensor say that it is a film camera?"""
    if element.tag == "property" and element.attributes.get("name") in {"film_camera", "fiducials"}:
        said = element.attributes.get("value", "")
    elif element.tag == "film_camera":
        said = element.text
    else:
        return False
    return said.strip().lower() in {"1", "true"}


def _pose(camera: Element, world: Element, chunk: Element) -> dict[str, Any]:
    """R, C and whether lengths are metres; {} for a camera that was not aligned."""
    transform = camera.find("transform")
    if transform is None:
        return {}
    rows = rows_of(_numbers(transform, 16), 4)
    rotation = [row[:3] for row in rows[:3]]
    position = [row[3] for row in rows[:3]]
    fault = rotation_fault(rotation)
    if fault:
        raise Faulty(f"the transform of {camera.attributes['label']} {fault}", (transform.line,), _REMEDY)
    to_world = world.find("transform")
    if to_world is None or not to_world.children:
        # neither control points nor a scale bar: unit and axes of the chunk are arbitrary
        return {"R": turned_axes(rotation, 1.0), "C": position, "metric": False}
    _refuse_geocentric(chunk)
    # C = scale * world_rotation * position + translation
    world_rotation, translation, scale = _similarity(to_world)
    moved = []
    for value, shift in zip(turned(world_rotation, position), translation, strict=True):
        moved.append(value * scale + shift)
    return {"R": turned_axes(product(world_rotation, rotation), 1.0), "C": moved}


def _refuse_geocentric(chunk: Element) -> None:
    """With a coordinate system of the Earth, the transform leads to the Earth's centre, where up is not z."""
    reference = chunk.find("reference")
    if reference is not None and reference.text.strip() and not reference.text.strip().startswith("LOCAL_CS"):
        what = "the cameras are in a coordinate system of the Earth, with its centre as the origin"
        raise Faulty(what, (reference.line,), _REMEDY)


def _similarity(transform: Element) -> tuple[Matrix, Vector, float]:
    """Rotation, translation and scale of the transform of a chunk or component; parts that are left out change nothing."""
    parts = {"rotation": 9, "translation": 3, "scale": 1}
    _refuse_unknown(transform, set(parts))
    values: dict[str, list[float]] = {"rotation": [1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0], "translation": [0.0] * 3, "scale": [1.0]}
    for name, count in parts.items():
        element = transform.find(name)
        if element is not None:
            values[name] = _numbers(element, count)
    rotation = rows_of(values["rotation"], 3)
    fault = rotation_fault(rotation)
    if fault:
        raise Faulty(f"the rotation {fault}", (transform.line,), _REMEDY)
    return rotation, values["translation"], values["scale"][0]


def _numbers(element: Element, count: int) -> list[float]:
    """The numbers in an element.  Raises Faulty if there are not `count`."""
    try:
        numbers = [float(word) for word in element.text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count:
        raise Faulty(f"<{element.tag}> must hold {count} numbers", (element.line,), _REMEDY)
    return numbers


def _refuse_unknown(element: Element, known: set[str]) -> None:
    """Raise Faulty if an element holds another one that is not known."""
    for child in element.children:
        if child.tag not in known:
            what = f"<{child.tag}> in <{element.tag}> is not read, so what it says would be lost"
            raise Faulty(what, (child.line,), _REMEDY)
