"""What is known of the changes of a site, and passed on from night to night."""

from __future__ import annotations

from dataclasses import dataclass

from ..contracts.ground_figures import Change
from ..contracts.short_repr import Record
from .arrays import Bools, Float32s, Float64s


@dataclass(frozen=True)
class Hull(Record):
    """Voxels around a change, and which of them are known to be free of it; voxel i of an axis holds i to i + 1 times `edge`."""

    axes: Float64s
    """(3, 3) rows east, north, up in the world, of unit length; a world point X has the coordinates `axes` X."""
    edge: float
    """Edge of a voxel, world lengths."""
    first: tuple[int, int, int]
    """Number of the first voxel along each axis, counted from the world's origin."""
    carved: Bools
    """(nx, ny, nz) True for voxels that cameras saw through, or over whose ground nothing stands."""


@dataclass(frozen=True)
class KnownPlace(Record):
    """A place at which something has appeared or vanished; a moved thing has one of each, with the same id."""

    id: str
    """Id of the change ("C17")."""
    vanished: bool
    """True if it stood there on the reference's night; False if it has stood there since."""
    change: Change
    """Its description on the last night."""
    points: Float64s
    """(n, 3) points of its surface that were seen on any night, and not seen through later."""
    sigma: Float32s
    """(n,) their standard deviations, world units."""
    cleared: Float32s
    """(n,) `change.evidence.Evidence.cleared` of the points."""
    hull: Hull
    """Space in which unseen parts of it may be."""
