"""Values of a site file that are valid one by one, and cannot be meant, or hardly: a focal length in millimetres, for instance.

What cannot be meant is refused, because a run would publish nonsense; what is only unlikely is a doubt, of which `wbflow run` and
`wbflow check` tell.  Both give the two numbers that do not go together.
"""

from __future__ import annotations

import datetime
import itertools
import math
import shlex
import shutil
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path

from ..errors import Location
from ..pipeline.parameter_docs import document
from ..pipeline.signature import Functions, Parameter
from ..pipeline.stages import STAGES, Stage
from ..words import format_size, number
from .calibration.calibrated import Lens
from .models import Camera, SiteFile, StageSettings
from .polygons import area, crossing, diameter
from .yaml_document import Problems, suggest

WIDEST_PINHOLE_DEG = 170.0
"""No pinhole (or brown) lens sees more, nor is calibrated that far; focal lengths in millimetres give 179 degrees."""
WIDEST_DEG = 400.0
"""No lens sees more than a full turn; fisheye calibrations state a little more than the picture shows."""
NARROWEST_DEG = 0.5
"""A camera that sees less is a telescope: its focal length may be in another unit."""
LARGEST_RADIANS = math.pi
"""A field of view in degrees below this may be one in radians."""
FLATTEST_PICTURE = 9 / 16
"""Height divided by width of the flattest usual pictures, assumed where only the field of view is stated."""
MOST_PIXEL_RATIO = 1.5
"""Largest ratio of fx and fy: pixels of cameras are nearly square."""
LEAST_SCALE = 0.4
MOST_SCALE = 2.5
"""A lens that moves points by such a factor halfway to the border of its picture is none."""
MOST_TANGENTIAL = 0.05
"""Tangential distortion p1, p2 of real lenses is a hundred times smaller; a larger one is a radial coefficient in its place."""
FARTHEST_M = 100_000.0
"""Cameras of one site that are further apart do not see the same things."""
LEAST_APART_M = 0.001
"""Two stated cameras closer than this are at the same place, which gives no depth."""
MOST_CAMERAS_COMPARED = 300
"""Sites with more cameras are not searched for two at the same place: the pairs are too many to be looked at in each run."""
MOST_DISTANCE_RATIO = 1.5
"""Largest ratio of a stated distance and that between stated positions; more is a mistake, not an error of measuring."""
SIGMAS = 4.0
"""... beyond so many standard deviations of the positions."""
LEAST_KEPT_BYTES = 10_000_000
"""Space for results below which not even one night of the smallest site is kept."""
LEAST_UP = 0.5
"""A picture whose up has a smaller share of the world's z stands on its side."""
FACTOR_OF_DEFAULT = 1000.0
"""A parameter that differs from its default by such a factor may be in another unit."""


def check_plausibility(
    file: SiteFile,
    cameras: Sequence[Camera],
    stages: Mapping[str, StageSettings],
    reader: Functions,
    problems: Problems,
    doubts: Problems,
) -> None:
    """Add what cannot be meant to `problems`, and what is only unlikely to `doubts`.

    Parameters
    ----------
    file, cameras, stages : SiteFile, sequence of Camera, mapping
        The validated file, and its cameras and settings of stages with calibrations merged.
    reader : Functions
        Tells the meaning of parameters.
    problems, doubts : Problems
        The problems of the file, and the doubts about it.
    """
    for position, camera in enumerate(cameras):
        _check_lens(file, position, camera.lens, problems, doubts)
        _check_privacy(position, camera, problems)
    _check_places(file, cameras, problems, doubts)
    _check_uprightness(cameras, doubts)
    _check_distances(file, cameras, problems)
    _check_control_points(file, cameras, doubts)
    _check_zones(file, problems, doubts)
    _check_zones_to_notify(file, problems)
    _check_expectations(file, doubts)
    _check_notify(file, problems.document.path.resolve().parent, doubts)
    _check_parameters(stages, reader, problems, doubts)


def _check_lens(file: SiteFile, position: int, lens: Lens, problems: Problems, doubts: Problems) -> None:
    """Do focal lengths, principal point, size of the pictures and distortion go together?"""
    entry = file.cameras[position]
    location: Location = ("cameras", position)
    if entry.intrinsics is not None:
        location = ("cameras", position, "intrinsics")
    elif entry.calibration is not None:
        location = ("cameras", position, "calibration")
    if lens.K is None:
        if lens.hfov_deg is not None and lens.hfov_deg <= LARGEST_RADIANS:
            in_degrees = math.degrees(lens.hfov_deg)
            what = f"a view of {lens.hfov_deg:g} degrees is that of a telescope; as radians it would be {in_degrees:.1f} degrees"
            doubts.add((*location, "hfov"), what, f"write degrees: hfov: {in_degrees:.1f}; or fx and fy in pixels")
        elif lens.hfov_deg is not None and entry.distortion is not None:
            halfway = _width_in_focal_lengths(lens, lens.hfov_deg) * FLATTEST_PICTURE / 4
            _check_distortion(("cameras", position, "distortion"), lens, halfway, problems, doubts)
        return
    if not lens.width or not lens.height:
        return
    fx, _, cx = lens.K[0]
    _, fy, cy = lens.K[1]
    field_deg = _field_deg(lens, fx)
    most_deg = WIDEST_DEG
    if lens.model in {"pinhole", "brown", "rational"}:
        most_deg = WIDEST_PINHOLE_DEG
    if lens.model != "equirectangular" and field_deg > most_deg:
        what = f"fx is {fx:g} pixels and the picture {lens.width} wide: the lens would see {field_deg:.1f} degrees"
        remedy = f"give fx and fy in pixels, not millimetres: fx = {lens.width} x focal length / width of the sensor"
        problems.add(location, what, remedy)
        return
    # the rest is only unlikely: there are odd cameras
    if field_deg < NARROWEST_DEG:
        what = f"fx is {fx:g} pixels and the picture {lens.width} wide: the lens would see only {field_deg:.2g} degrees"
        doubts.add(location, what, "give fx, fy, cx, cy, width and height in pixels of one and the same picture")
    ratio = max(fx / fy, fy / fx)
    if ratio > MOST_PIXEL_RATIO:
        what = f"fx is {fx:g} and fy {fy:g}: pixels {ratio:.2g} times as long as wide"
        doubts.add(location, what, "correct fx or fy; they are nearly equal in all cameras")
    if not (0 <= cx <= lens.width and 0 <= cy <= lens.height):
        what = f"the principal point {cx:g}, {cy:g} is outside the picture of {lens.width}x{lens.height} pixels"
        doubts.add(location, what, "give K, width and height of the same picture; width comes before height")
    if entry.distortion is not None:
        location = ("cameras", position, "distortion")
    halfway = min(lens.width / fx, lens.height / fy) / 4  # a quarter of the side: half of the way from the middle
    _check_distortion(location, lens, halfway, problems, doubts)


def _width_in_focal_lengths(lens: Lens, field_deg: float) -> float:
    """The width of a picture divided by the focal length, from its horizontal field of view: the inverse of `_field_deg`."""
    field = math.radians(field_deg)
    return field if lens.model == "fisheye" else 2 * math.tan(field / 2)


def _field_deg(lens: Lens, fx: float) -> float:
    """The horizontal field of view without distortion: of a pinhole, or of a lens whose angles are proportional to pixels."""
    if lens.model in {"pinhole", "brown", "rational"}:
        return 2 * math.degrees(math.atan(lens.width / (2 * fx)))
    if lens.model in {"fisheye", "thin-prism-fisheye", "rad-tan-thin-prism-fisheye"}:
        return math.degrees(lens.width / fx)
    return 60.0  # other models state their field with further parameters


def _check_distortion(location: Location, lens: Lens, halfway: float, problems: Problems, doubts: Problems) -> None:
    """Is the distortion one of a lens?

    halfway: half the distance from the middle of the picture to its nearer border, divided by the focal length.  There, real
    lenses change the distance from the middle by a few percent, and certainly do not fold the picture over.
    """
    if lens.model not in {"brown", "rational", "fisheye"} or not any(lens.distortion):
        return
    images = [_distorted_radius(lens, halfway * step / 20) for step in range(1, 21)]
    # folded: a point further out is imaged further in
    is_folded = any(later <= earlier for earlier, later in itertools.pairwise([0.0, *images]))
    scale = images[-1] / halfway
    if is_folded or not LEAST_SCALE <= scale <= MOST_SCALE:
        largest = max(lens.distortion, key=abs)
        what = f"a coefficient of distortion is {largest:g}: a point {halfway:.2g} from the middle would be at {images[-1]:.2g}"
        what += " (in focal lengths)"
        if is_folded:
            what += ", and the picture would be folded"
        problems.add(location, what, "give the coefficients in the order of the model, for pixels divided by the focal length")
        return
    if lens.model != "fisheye" and len(lens.distortion) > 3:
        tangential = max(lens.distortion[2:4], key=abs)
        if abs(tangential) > MOST_TANGENTIAL:
            what = f"the tangential distortion is {tangential:g}; of real lenses it is below {MOST_TANGENTIAL:g}"
            doubts.add(location, what, "the order is k1, k2, p1, p2, k3: is this one k3?")


def _distorted_radius(lens: Lens, radius: float) -> float:
    """The distance from the middle at which a point is imaged, by the radial coefficients, in focal lengths."""
    k = lens.distortion
    if lens.model == "fisheye":
        # angle (1 + k1 angle^2 + k2 angle^4 + ...)
        angle = math.atan(radius)
        return angle * (1 + sum(coefficient * angle ** (2 * power) for power, coefficient in enumerate(k[:4], 1)))
    # k1 k2 p1 p2 k3 k4 k5 k6: a polynomial, of a rational lens divided by another one
    k1, k2, _, _, k3 = [*k, 0.0, 0.0, 0.0, 0.0][:5]
    r2 = radius * radius
    numerator: float = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    denominator: float = 1.0
    if len(k) >= 8:
        denominator = 1 + k[5] * r2 + k[6] * r2**2 + k[7] * r2**3
    if not denominator:
        return math.inf
    return radius * numerator / denominator


def _check_privacy(position: int, camera: Camera, problems: Problems) -> None:
    """A run would refuse all captures of a camera whose polygon is not within the picture."""
    size = (camera.lens.width, camera.lens.height)
    for index, polygon in enumerate(camera.privacy):
        location = ("cameras", position, "privacy", index)
        crossed = crossing(polygon)
        if crossed:
            problems.add(location, crossed, "give the corners in their order along the border, as wbflow edit draws them")
            continue
        outside = polygon_outside(polygon, size) if all(size) else ""
        if outside:
            problems.add(location, outside, "corners are pixels of a capture, x before y, or shares of its width and height")


def polygon_outside(polygon: Sequence[Sequence[float]], size: tuple[int, int]) -> str:
    """Whether a polygon of privacy lies wholly or partly outside a picture of this width and height, in words; "" if not.

    Corners up to 1 are shares of the picture's sides.
    """
    width, height = size
    xs = [corner[0] for corner in polygon]
    ys = [corner[1] for corner in polygon]
    if max(*xs, *ys) <= 1:
        return ""
    reach = f"the polygon reaches from {min(xs):g}, {min(ys):g} to {max(xs):g}, {max(ys):g}, the picture is {width}x{height}"
    if min(xs) >= width or min(ys) >= height:
        return f"nothing is blanked: {reach}, so the polygon is wholly outside"
    if max(xs) > width or max(ys) > height:
        return f"{reach}, so a part of the polygon is outside"
    return ""


def _check_places(file: SiteFile, cameras: Sequence[Camera], problems: Problems, doubts: Problems) -> None:
    """Are the stated cameras near each other, and not at one place?"""
    centres = {k: camera.placement.C for k, camera in enumerate(cameras) if camera.placement.C is not None}
    if len(centres) < 2:
        return
    spread = max(math.dist(a, b) for a, b in itertools.combinations(centres.values(), 2))
    if not spread <= FARTHEST_M:  # also if it is not a number
        # the median, so that one camera that is off does not move the middle
        middle = [statistics.median(centre[axis] for centre in centres.values()) for axis in range(3)]
        k = max(centres, key=lambda index: (_swapped_is_nearer(file, index), math.dist(centres[index], middle)))
        what = f"camera {cameras[k].id} is {number(spread / 1000)} km from another; those of one site are within 100 km"
        problems.add(_pose_location(file, k), what, _remedy_of_far(file, k))
        return
    if len(centres) > MOST_CAMERAS_COMPARED:
        return
    for (i, first), (j, second) in itertools.combinations(centres.items(), 2):
        if math.dist(first, second) < LEAST_APART_M:
            what = f"cameras {cameras[i].id} and {cameras[j].id} are stated {math.dist(first, second):g} m apart: at one place"
            doubts.add(_pose_location(file, j), what, "give each camera its own position: without a baseline there is no depth")
            return


def _pose_location(file: SiteFile, k: int) -> Location:
    if file.cameras[k].pose:
        return ("cameras", k, "pose")
    return ("cameras", k)  # its pose is of the calibration


def _geodetic(file: SiteFile, k: int) -> tuple[float, float, float] | None:
    pose = file.cameras[k].pose
    return pose.geodetic if pose else None


def _swapped_is_nearer(file: SiteFile, k: int) -> bool:
    """Would a camera be near the others if its latitude and longitude were exchanged?"""
    own = _geodetic(file, k)
    if own is None:
        return False
    latitude, longitude, _ = own
    for j in range(len(file.cameras)):
        other = _geodetic(file, j)
        if j != k and other and abs(longitude - other[0]) < 1 and abs(latitude - other[1]) < 1:  # degrees
            return True
    return False


def _remedy_of_far(file: SiteFile, k: int) -> str:
    """What to do about a camera that is far from the others."""
    own = _geodetic(file, k)
    if own and _swapped_is_nearer(file, k):
        located = sum(_geodetic(file, j) is not None for j in range(len(file.cameras)))
        other = ", or those of the other camera" if located == 2 else ""  # of two, either may be the wrong one
        return f"latitude and longitude seem to be exchanged: latitude: {own[1]:g}, longitude: {own[0]:g}{other}"
    return "give all positions in the same coordinates, in metres or in degrees"


def _check_uprightness(cameras: Sequence[Camera], doubts: Problems) -> None:
    """Is z up?  Where all pictures stand upright along another axis, the world is of a program whose y is up."""
    ups = [[-value for value in camera.placement.R[1]] for camera in cameras if camera.placement.R is not None]
    if not ups:
        return
    mean = [statistics.fmean(up[axis] for up in ups) for axis in range(3)]
    is_along_other_axis = max(abs(mean[0]), abs(mean[1])) > LEAST_UP
    none_is_upright = max(abs(up[2]) for up in ups) < LEAST_UP
    if len(ups) > 1 and is_along_other_axis and none_is_upright:
        axis = "x" if abs(mean[0]) > abs(mean[1]) else "y"
        share = max(mean[0], mean[1], key=abs)
        what = f"by the stated poses, up is {axis} in all {len(ups)} pictures ({share:.2f}), and not z ({mean[2]:.2f})"
        doubts.add(("cameras",), what, "turn the world so that z is up: heights, ground and zones depend on it")


def _check_distances(file: SiteFile, cameras: Sequence[Camera], problems: Problems) -> None:
    """Do stated distances fit stated positions?"""
    places = {camera.id: camera.placement for camera in cameras}
    for k, (left, right, metres) in enumerate(file.distances):
        if not isinstance(left, str) or not isinstance(right, str) or left == right:
            continue  # a problem of its own
        first = places.get(left)
        second = places.get(right)
        if first is None or second is None or first.C is None or second.C is None or not isinstance(metres, int | float):
            continue
        if isinstance(metres, bool) or not (first.metric and second.metric) or not metres > 0:
            continue
        apart = math.dist(first.C, second.C)
        tolerance = SIGMAS * math.hypot(first.sigma_m, second.sigma_m)
        ratio = max(apart / metres, metres / apart) if apart else math.inf
        if ratio > MOST_DISTANCE_RATIO and abs(apart - metres) > tolerance:
            what = f"{left} and {right} are stated {metres:g} m apart, and their stated positions are {apart:.4g} m apart"
            problems.add(("distances", k), what, "correct one of the two; distances are in metres")


def _check_control_points(file: SiteFile, cameras: Sequence[Camera], doubts: Problems) -> None:
    """Are the pixels of control points within the pictures?"""
    lenses = {camera.id: camera.lens for camera in cameras}
    for k, point in enumerate(file.control_points):
        for camera, (x, y) in point.pixels.items():
            lens = lenses.get(camera)
            if lens is None or not lens.width:
                continue
            if not (-0.5 <= x <= lens.width and -0.5 <= y <= lens.height):
                what = f"pixel {x:g}, {y:g} is outside the picture of {lens.width}x{lens.height} pixels"
                doubts.add(("control_points", k, "pixels", camera), what, "give pixels of a capture, x before y")


def _check_zones(file: SiteFile, problems: Problems, doubts: Problems) -> None:
    """Can anything be found within the bounds, and in each zone?"""
    if file.bounds:
        sides = [abs(a - b) for a, b in zip(*file.bounds, strict=True)]
        if min(sides) == 0:
            size = " x ".join(f"{side:g}" for side in sides)
            what = f"the box is {size} m: it holds nothing"
            problems.add(("bounds",), what, "give two opposite corners: bounds: [[-20, -30, 0], [20, 30, 12]]")
    for k, zone in enumerate(file.zones or []):
        location: Location = ("zones", k, "polygon")
        crossed = crossing(zone.polygon)
        if crossed:
            problems.add(location, f"zone {zone.name}: {crossed}", "give the corners in their order along the border")
            continue
        if area(zone.polygon) == 0:
            problems.add(location, f"zone {zone.name} has an area of 0 m2", "give three corners or more that are not on a line")
            continue
        extent = diameter(zone.polygon)
        if zone.least_m > extent:
            what = f"zone {zone.name} is {extent:.3g} m across, and changes below {zone.least_m:g} m are not reported in it"
            doubts.add(("zones", k, "least_m"), what, "give a least size in metres that fits into the zone")
        if file.bounds and not _overlap(zone.polygon, file.bounds):
            corner = f"{zone.polygon[0][0]:g}, {zone.polygon[0][1]:g}"
            what = f"zone {zone.name} at {corner} is outside the bounds: nothing is found there"
            doubts.add(location, what, "move the zone, or extend bounds")


def _check_zones_to_notify(file: SiteFile, problems: Problems) -> None:
    """The zones for whose changes somebody is notified must exist."""
    wanted = file.notify.changes if file.notify else False
    names = [zone.name for zone in file.zones or []]
    for k, name in enumerate((wanted.zones or []) if wanted else []):
        if name not in names:
            remedy = suggest(name, names, f"name zones of `zones:`: {', '.join(names) or 'there are none'}")
            problems.add(("notify", "changes", "zones", k), f"there is no zone {name!r}", remedy)


def _overlap(polygon: Sequence[Sequence[float]], bounds: Sequence[Sequence[float]]) -> bool:
    """Do the boxes around a polygon and between two corners overlap, seen from above?"""
    for axis in (0, 1):
        low, high = sorted((bounds[0][axis], bounds[1][axis]))
        values = [corner[axis] for corner in polygon]
        if max(values) < low or min(values) > high:
            return False
    return True


def _check_expectations(file: SiteFile, doubts: Problems) -> None:
    """Can what is expected of a good night be reached, and is what is kept enough for a night?"""
    count = len(file.cameras)
    most = {"cameras": count, "pairs": count * (count - 1) // 2, "coverage": 1}
    for name, limit in most.items():
        value = getattr(file.expect, name)
        if value > max(limit, 1):
            what = f"{value:g} is expected, {limit} is the most that this site can have"
            doubts.add(("expect", name), what, f"give a share of what is usual: {name}: 0.7")
    if 1 < file.expect.points <= 100:
        points = file.expect.points
        what = f"{points:g} is a count of points; as percent of what is usual it would be {points / 100:g}"
        doubts.add(("expect", "points"), what, f"for a share write points: {points / 100:g}")
    today = datetime.datetime.now(datetime.UTC).date()
    tomorrow = today + datetime.timedelta(days=1)  # of a site further east it may be that already
    if file.expect.since and file.expect.since > str(tomorrow):
        doubts.add(("expect", "since"), f"{file.expect.since} is in the future; today is {today}", "give a day with a good night")
    if file.keep.bytes is not None and file.keep.bytes < LEAST_KEPT_BYTES:
        what = f"{format_size(file.keep.bytes)} are kept; a night of the smallest site takes {format_size(LEAST_KEPT_BYTES)}"
        doubts.add(("keep", "bytes"), what, "write the unit, e.g. bytes: 50GB")


_SHELL_WORDS = {
    *("if", "for", "while", "case", "until", "{", "(", "[", "[[", "!", ":", ".", "test", "echo", "printf", "cd", "exec", "eval"),
    *("source", "true", "set", "export", "read", "exit"),
}
"""First words of a shell command that are no programs."""


def _check_notify(file: SiteFile, folder: Path, doubts: Problems) -> None:
    """Is there the program that is called after a night?"""
    if file.notify is None:
        return
    command = file.notify.command
    try:
        words = shlex.split(command) if isinstance(command, str) else list(command)
    except ValueError as error:
        doubts.add(("notify", "command"), f"the shell cannot read it: {error}", "close the quotation")
        return
    if isinstance(command, str):
        words = list(itertools.dropwhile(lambda word: "=" in word.split("/")[0], words))  # settings of variables come first
    # what the shell itself understands, or would compute, is not looked for
    program = words[0].rstrip(";") if words else ""
    is_of_shell = program.startswith(("$", "`", "(", "#")) or (isinstance(command, str) and program in _SHELL_WORDS)
    if not program or is_of_shell:
        return
    if "/" in program and not program.startswith("~"):
        path = str(folder / program)
    else:
        path = str(Path(program).expanduser())
    if shutil.which(path) is None:
        what = f"there is no program {program!r} here"
        if Path(path).is_file():
            what = f"{program!r} is a file that cannot be executed"
        doubts.add(
            ("notify", "command"), what, "install it, give its path, or chmod +x it; a run calls it in the site file's folder"
        )


def _check_parameters(stages: Mapping[str, StageSettings], reader: Functions, problems: Problems, doubts: Problems) -> None:
    """Are the numbers of the section `stages` of the order of their defaults, and shares below 1?"""
    by_name: dict[str, Stage] = {stage.name: stage for stage in STAGES}
    for name, settings in stages.items():
        if not settings.parameters or settings.use:
            continue
        stage = by_name[name]
        # a parameter may be of the stage's function or of any of its methods
        dotted = [stage.function]
        if stage.method:
            dotted += reader.table(stage.method.table).values()
        checked: set[str] = set()  # several methods may have a parameter of one name: it is judged once
        for function in dotted:
            signature = reader.signature(function)
            known = signature.parameters
            names = [key for key in settings.parameters if key in known and key not in checked]
            checked.update(names)
            used = [known[key] for key in names]
            _, docs = document(signature, used)
            for doc in docs:
                location = ("stages", name, doc.parameter.name)
                value = settings.parameters[doc.parameter.name]
                _check_number(location, doc.parameter, f"{doc.unit} {doc.meaning}", value, problems, doubts)


def _check_number(
    location: Location, parameter: Parameter, meaning: str, value: object, problems: Problems, doubts: Problems
) -> None:
    """Is a number that a parameter is set to of the order of its default, and from 0 to 1 if it is a share?

    meaning: unit and meaning of the parameter, in words.
    """
    default = parameter.default
    # a default of 0 has no order of magnitude
    if isinstance(value, bool) or not isinstance(value, int | float) or isinstance(default, bool):
        return
    if not isinstance(default, int | float) or not default:
        return
    is_from_0_to_1 = "probability" in meaning or "0 to 1" in meaning
    # a share of something can be a little above 1; from 2 on it is a percentage
    may_be_percent = is_from_0_to_1 or ("share" in meaning and value >= 2)
    if 0 < default < 1 and may_be_percent and not 0 <= value <= 1:
        what = f"{value:g} is not from 0 to 1; the default is {default:g}"
        remedy = "give a number from 0 to 1"
        if 1 < value <= 100:
            remedy = f"as percent: {value / 100:g}"
        problems.add(location, what, remedy)
        return
    ratio = abs(value / default)
    if value and not 1 / FACTOR_OF_DEFAULT < ratio < FACTOR_OF_DEFAULT:
        unit = ""
        if parameter.name.endswith(("_px", "_m", "_mm", "_deg", "_s")):
            unit = f" ({meaning.strip().split(' ')[0]})"
        doubts.add(location, f"{value:g} is far from the default, {default:g}{unit}", "check the unit: wbflow stages shows it")
