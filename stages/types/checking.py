"""The shapes of arrays, and a check of what a user's program passes or a user's function returns."""

from __future__ import annotations

import dataclasses
import types
import typing
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt

from ..contracts.reasons import Rejected
from ..contracts.short_repr import Record

Shape = tuple[int | str, ...]
"""Lengths of an array's axes; a name stands for the same length in all fields of an object."""

SHAPES: Mapping[str, Mapping[str, Shape]] = {
    "View": {"K": (3, 3), "distortion": ("coefficients",)},
    "Camera": {"K": (3, 3), "R": (3, 3), "C": (3,), "distortion": ("coefficients",)},
    "Frame": {"image": ("h", "w", 3), "mask": ("h", "w")},
    "Features": {
        "xy": ("n", 2),
        "frames": ("n", 2, 2),
        "descriptors": ("n", "d"),
        "responses": ("n",),
        "tilts": ("n",),
        "lookalikes": ("p",),
    },
    "Matches": {"x1": ("n", 2), "x2": ("n", 2), "i1": ("n",), "i2": ("n",), "probability": ("n",), "affine": ("n", 2, 2)},
    "Geometry": {
        "F": (3, 3),
        "x1": ("n", 2),
        "x2": ("n", 2),
        "i1": ("n",),
        "i2": ("n",),
        "probability": ("n",),
        "cam2_R_cam1": (3, 3),
        "cam2_t_cam1": (3,),
        "noise_px": ("n",),
        "lens1": (3, 3),
        "lens2": (3, 3),
    },
    "Rectification": {"H1": (3, 3), "H2": (3, 3), "bend1": (6,), "bend2": (6,)},
    "Disparity": {"left": ("h", "w1"), "right": ("h", "w2"), "confidence_left": ("h", "w1"), "confidence_right": ("h", "w2")},
    "DepthMap": {
        "depth": ("h", "w"),
        "sigma": ("h", "w"),
        "slope_x": ("h", "w"),
        "slope_y": ("h", "w"),
        "support": ("h", "w"),
        "sure": ("h", "w"),
    },
    "Cloud": {
        "points": ("n", 3),
        "normals": ("n", 3),
        "colors": ("n", 3),
        "confidence": ("n",),
        "views": ("n",),
        "sigma_mm": ("n",),
    },
    "Homographies": {"H1": (3, 3), "H2": (3, 3)},
    "DenseMatches": {"left": ("h", "w"), "right": ("h", "w"), "confidence_left": ("h", "w"), "confidence_right": ("h", "w")},
}
"""Shapes of arrays by class and field."""

UNKNOWN_AS_NAN = {"DepthMap", "DenseMatches"}
"""Classes whose arrays have nan where nothing is known; those of all others in `SHAPES` are finite."""

PIXELS = {"Features": {"xy": "view"}, "Matches": {"x1": "view1", "x2": "view2"}, "Geometry": {"x1": "view1", "x2": "view2"}}
"""Fields (n, 2) of pixels, and the field with the view that they lie in."""

SHARES = {
    "Matches": ("probability",),
    "Geometry": ("probability",),
    "Cloud": ("confidence",),
    "DenseMatches": ("confidence_left", "confidence_right"),
}
"""Fields whose values lie between 0 and 1."""

BORDER_PX = 1.0
"""Pixels may lie outside of their view by this much: they are measured with an error."""


def check_result(result: object, function: str, wanted: Any, lengths: Mapping[str, int] | None = None) -> None:
    """Check what a user's function returned: types, shapes and dtypes, finite values, pixels inside their view.

    Raises TypeError, which names the function and the field.

    Parameters
    ----------
    result : what the function returned.
    function : its dotted name.
    wanted : the type of what it should return, or a union of types.
    lengths : lengths of axes that are known, by their names in `SHAPES`.
    """
    if not _fits(result, wanted):
        raise TypeError(f"{function} returned {_named(type(result))}; {_named(wanted)} is needed")
    if fault := fault_in(result, lengths):
        raise TypeError(f"{function} returned a wrong {type(result).__name__}: {fault}")


HOW_TO_GET = {
    "Frame": "read_frame(PATH) or Frame.from_image(PIXELS)",
    "Features": "detect(frame)",
    "Matches": "match(left, right)",
    "Geometry": "estimate_geometry(matches, left, right)",
    "Rectification": "rectify(geometry)",
}
"""The call that gives an object of each type, for messages."""


def require(wanted: Any, **arguments: object) -> None:
    """Raise ValueError, with what to pass, if an argument is of another type; a result that was rejected says why it was.

    wanted: a type or a union of types; arguments: values by name.
    """
    for name, value in arguments.items():
        if isinstance(value, Rejected):
            raise ValueError(f"{name} was rejected: {value.reason}")
        if not _fits(value, wanted):
            calls = [HOW_TO_GET[kind] for kind in _named(wanted).split(" or ") if kind in HOW_TO_GET]
            how = f": {' or '.join(calls)} gives one" if calls else ""
            raise ValueError(f"{name} is a {_named(type(value))}; {_named(wanted)} is needed{how}")


def fault_in(result: object, lengths: Mapping[str, int] | None = None) -> str:
    """The first fault in an object of the vision, as "x1 is float32 (12, 2); float64 (n, 2) is needed"; "" if there is none.

    lengths: see `check_result`.
    """
    kind: Any = type(result)
    name = kind.__name__
    shapes = SHAPES.get(name, {})
    if isinstance(result, Rejected) or not (shapes or dataclasses.is_dataclass(result)):
        return ""
    known = {**(lengths or {}), **_lengths_of_view(result)}
    for field, annotation in _annotations(kind).items():
        value = getattr(result, field)
        if fault := _fault_in_field(value, annotation, shapes.get(field), known):
            return f"{field} {fault}"
        is_number = isinstance(value, np.ndarray) and value.dtype.kind == "f"
        if is_number and field in shapes and name not in UNKNOWN_AS_NAN and not np.isfinite(value).all():
            return f"{field} has {np.count_nonzero(~np.isfinite(value)):,} of {value.size:,} values that are not finite"
        if fault := _fault_in_parts(field, value):
            return fault
    return _fault_in_values(result, name)


def wrong_array(value: object, dtype: npt.DTypeLike, shape: Shape | None, lengths: dict[str, int]) -> str:
    """What is wrong with an array, in words that follow its name; "" if nothing is.

    Parameters
    ----------
    value : what should be an array.
    dtype, shape : of the array that is needed; None: any shape.
    lengths : lengths of axes with a name, as far as they are known; those of this array are added.
    """
    wanted = str(np.dtype(dtype))
    if shape is not None:
        wanted += f" ({', '.join(map(str, shape))}{',' if len(shape) == 1 else ''})"
    if not isinstance(value, np.ndarray):
        return f"is a {type(value).__name__}; an array, {wanted}, is needed"
    wrong = f"is {value.dtype} {value.shape}; {wanted} is needed"
    if value.dtype != np.dtype(dtype):
        return wrong
    if shape is None:
        return ""
    if value.shape == (0,):  # np.array([]), of no rows at all
        shape = shape[:1]
    if value.ndim != len(shape):
        return wrong
    for length, axis in zip(value.shape, shape, strict=True):
        needed = lengths.setdefault(axis, length) if isinstance(axis, str) else axis
        if length != needed:
            return wrong if isinstance(axis, int) else f"{wrong}, with {axis} = {needed}"
    return ""


def _lengths_of_view(result: Any) -> dict[str, int]:
    """Height and width of a frame's image, by its view."""
    if type(result).__name__ == "Frame" and hasattr(result.view, "width"):
        return {"h": result.view.height, "w": result.view.width}
    return {}


def _fault_in_field(value: object, annotation: Any, shape: Shape | None, lengths: dict[str, int]) -> str:
    if _fits(value, annotation, arrays=False):
        return ""
    for choice in _choices(annotation):
        if typing.get_origin(choice) is np.ndarray:
            (scalar,) = typing.get_args(typing.get_args(choice)[1])
            return wrong_array(value, scalar, shape, lengths)
    return f"is {_named(type(value))}; {_named(annotation)} is needed"


def _fault_in_parts(field: str, value: object) -> str:
    """The first fault in an object that a field holds, or in those of a mapping."""
    parts = {field: value}
    if isinstance(value, Mapping):
        parts = {f"{field}[{key}]": part for key, part in value.items()}
    for name, part in parts.items():
        if isinstance(part, Record) and (fault := fault_in(part)):
            return f"{name}.{fault}"
    return ""


def _fault_in_values(result: Any, name: str) -> str:
    """The first array with values that cannot be meant, in words."""
    for field, view_field in PIXELS.get(name, {}).items():
        x = getattr(result, field)
        view = getattr(result, view_field)
        if not x.size:
            continue
        highest = np.array([view.width, view.height]) - 0.5 + BORDER_PX
        outside = ((x < -0.5 - BORDER_PX) | (x > highest)).any(axis=1)
        if outside.any():
            column, row = x[outside][0]
            count = f"{np.count_nonzero(outside):,} of {len(x):,} points"
            picture = f"the {view.width} x {view.height} picture"
            return f"{field} has {count} outside of {picture}, such as ({column:.6g}, {row:.6g})"
    for field in SHARES.get(name, ()):
        values = getattr(result, field)
        if values.size and (values.min() < 0 or values.max() > 1):
            return f"{field} is {values.min():.3g} to {values.max():.3g}; values from 0 to 1 are needed"
    return ""


@cache
def _annotations(kind: Any) -> dict[str, Any]:
    """Types of the fields of a dataclass, or of a named tuple, by name."""
    hints = typing.get_type_hints(kind)
    names = [field.name for field in dataclasses.fields(kind)] if dataclasses.is_dataclass(kind) else list(hints)
    return {name: hints[name] for name in names}


def _choices(annotation: Any) -> tuple[Any, ...]:
    """The types of a union; of any other type, itself."""
    if typing.get_origin(annotation) in (typing.Union, types.UnionType):
        return typing.get_args(annotation)
    return (annotation,)


def _fits(value: object, annotation: Any, arrays: bool = True) -> bool:
    """Is the value of one of the types?  Contents of tuples and mappings are not looked at.

    arrays: any array is of the type of an array; False: none is.
    """
    for choice in _choices(annotation):
        kind = typing.get_origin(choice) or choice
        if kind is typing.Literal:
            fits = value in typing.get_args(choice)
        elif kind is np.ndarray and not arrays:
            fits = False
        elif kind is Any or not isinstance(kind, type):
            fits = True  # a type variable says nothing
        else:
            fits = isinstance(value, (int, float) if kind is float else kind)
        if fits:
            return True
    return False


def _named(annotation: Any) -> str:
    """A type as it is written in a program."""
    names = [str(getattr(choice, "__name__", choice)) for choice in _choices(annotation)]
    return " or ".join(names).replace("NoneType", "None")
