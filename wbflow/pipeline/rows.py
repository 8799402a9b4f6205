"""What can be said of a stage: the form of the rows of the pipeline's table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Any, Literal

Scope = Literal["camera", "pair", "site"]


class Role(Enum):
    """What the engine needs a stage for, besides handing on its result."""

    FRAME = auto()
    """The night's view of a camera: without it the camera is lost."""
    PAIR_GRAPH = auto()
    """Says which pairs of cameras are matched."""
    DENSE_PAIRS = auto()
    """Says which are made dense, once the cameras are placed; where it takes no part those that are matched."""
    MATCHES = auto()
    """Corresponding points of a pair."""
    GEOMETRY = auto()
    """What of a pair's correspondences one geometry explains."""
    WORLD = auto()
    """The cameras in one frame, in one or several components."""
    RECTIFICATION = auto()
    """How a pair is resampled to common rows."""
    DISPARITY = auto()
    """Dense matches of a rectified pair."""
    DEPTH = auto()
    """Depth of a camera's view from its pairs."""
    REFINED_DEPTH = auto()
    """The same, by all views at once."""
    PRODUCT = auto()
    """The cloud: what a night is for."""
    HEALTH = auto()
    """What became of a camera since the reference was pinned."""


class Which(Enum):
    """Of which subjects an input is taken."""

    SAME = auto()
    """Of the task's own subject."""
    LEFT = auto()
    """Of the pair's left camera."""
    RIGHT = auto()
    """Of the pair's right camera."""
    ALL = auto()
    """Of all subjects that have it, as a mapping."""
    AROUND = auto()
    """Of the cameras that the one in question makes dense pairs with, and of these pairs, as a mapping."""
    NEAR = auto()
    """Of these cameras and a few that make pairs with them (see `Subjects.near`), as a mapping."""


class SiteValue(Enum):
    """What a site file and its captures can give to a stage."""

    CAPTURES = auto()
    """The capture files of a camera, as they are: a list."""
    MASK = auto()
    """The mask file of a camera, as it is."""
    PRIVACY = auto()
    """What nobody may see of a camera's picture."""
    LENS = auto()
    """Intrinsics of a camera."""
    PLACEMENT = auto()
    """Pose of a camera."""
    SURVEY = auto()
    """Distances, control points and coordinate system of the site."""
    FILE = auto()
    """A file that the stage's section names, as it is."""


@dataclass(frozen=True)
class Part:
    """A part of an artifact that can be needed on its own (see `artifact.parts`)."""

    field: str
    """A field of the artifact."""
    entry: str | None = None
    """In the table None; in a plan, the entry of a mapping field: a camera's id, or "left--right"."""

    def __str__(self) -> str:
        return f"{self.field}[{self.entry}]" if self.entry is not None else self.field

    def of(self, result: Any) -> Any:
        """The part of an artifact."""
        value = getattr(result, self.field)
        return value if self.entry is None else value[self.entry]


@dataclass(frozen=True)
class FromStage:
    """An input that another stage makes."""

    stage: str
    which: Which = Which.SAME
    part: Part | None = None
    """Only this part; of a mapping field of a site-wide stage, the entry of the camera or pair in question, else all of it."""
    optional: bool = False
    """May be missing: then the function gets None, or an entry less."""
    unless_posed: bool = False
    """Not needed (an empty mapping) where the site file gives every camera's intrinsics and pose."""
    only_if_rough: bool = False
    """Not needed (an empty mapping) where the site file states no whole pose with standard deviations."""
    empty_if_stated: bool = False
    """May be an empty mapping where the site file states the intrinsics and poses of two cameras or more."""
    unless: tuple[str, ...] = ()
    """May be missing where the inputs of these names are there."""


@dataclass(frozen=True)
class FromSite:
    """An input that the site file or the captures give."""

    value: SiteValue
    which: Which = Which.SAME
    optional: bool = False
    named: str = ""
    """Of a file: what it is called in the stage's section, and among the arguments."""


@dataclass(frozen=True)
class FromReference:
    """An input that the pinned reference holds: what a stage made then.

    Always optional: the function gets None, or an empty mapping, where there is no reference, or where tonight is its own night.
    """

    stage: str
    which: Which = Which.SAME
    part: Part | None = None


@dataclass(frozen=True)
class FromPast:
    """An input that earlier nights have left in their records: what was found of a camera since the reference was pinned."""

    kind: str
    """Dotted name of the dataclass that it is handed over as; its fields are lists, one number for each night, oldest first."""
    figures: tuple[str, ...]
    """Names of its fields, and of the figures of the camera's health that they hold."""
    nights: int = 30
    """So many nights at most."""


Need = FromStage | FromSite | FromReference | FromPast


@dataclass(frozen=True)
class Rework:
    """Another function for a stage, that makes its result from the reference's."""

    function: str
    needs: Mapping[str, Need]


Instead = Literal["kept", "anew"] | Rework
"""What becomes of a result of the reference: it is used as it is, made anew as if there were none, or reworked."""


@dataclass(frozen=True)
class Held:
    """A result that the reference answers for as long as the cameras in question stand as they did."""

    nudged: Instead
    """Where one of them was nudged, and by how much is known."""
    moved: Instead
    """Where one of them was moved, or is new."""


@dataclass(frozen=True)
class Judges:
    """Figures of a result that say what became of a camera (see `records.record.Health`)."""

    state: str
    text: str
    figures: str
    expected: str
    remedy: str
    corrected: str
    """Its pose is known from the reference and from how it has turned, whatever the state."""


@dataclass(frozen=True)
class Picture:
    """How a result is shown.

    The function gets the result as its first argument, and by their names those of the stage's inputs, or of `needs`, that it
    asks for; it returns the bytes of a JPEG file.
    """

    function: str
    needs: Mapping[str, Need] = field(default_factory=dict)


@dataclass(frozen=True)
class PointTable:
    """A result that is kept as a PLY file, rather than as an artifact of arrays."""

    columns: str
    """Dotted function: the result -> its columns by name."""
    restore: str
    """Dotted function: columns by name -> the result."""
    figures: str
    """Dotted function: the result -> figures that its fields do not tell."""

    suffix = ".ply"


@dataclass(frozen=True)
class Method:
    """A stage's choice among functions: one parameter names a row of a table, or any function as package.module:function."""

    parameter: str
    """The parameter that chooses."""
    table: str
    """Dotted name of a dictionary literal: name -> "package.module:function"."""
    given: tuple[str, ...] = ()
    """Names of arguments that the stage itself hands to its methods, besides its needs and offers."""


@dataclass(frozen=True)
class Renamed:
    """A parameter that had another name, or other values, in an earlier version; still accepted, with a note."""

    now: str
    values: Mapping[str, str] = field(default_factory=dict)
    """New value by old value."""


@dataclass(frozen=True)
class Entry:
    """An entry of a figure that maps cameras, or pairs as "left--right"."""

    figure: str
    field: str = ""
    """One field of the entry; "" for all of it."""


@dataclass(frozen=True)
class Expects:
    """A figure of the whole night that is compared with what is usual."""

    factors: tuple[str, ...]
    """Figures that run.json tells of the stage; the product of them is compared."""
    unit: str
    words: str
    """What it measures."""


@dataclass(frozen=True)
class Reports:
    """What run.json says of a stage's results: of a site-wide one under its name.  A camera or pair whose task has no result is
    not ok."""

    fields: Mapping[str, str] = field(default_factory=dict)
    """Figure by field of the camera's or pair's record."""
    rejected: Mapping[str, str] = field(default_factory=dict)
    """The same, of a rejection."""
    notes: str = ""
    """Figure that holds notes for the operator."""
    sums: tuple[str, ...] = ()
    """Fields that add up over the views of a camera; of others it has the mean."""
    expects: Expects | None = None
    """Of a site-wide stage: what should be as much as is usual; `expect` in the site file has it under the stage's name."""


@dataclass(frozen=True)
class WorldReports:
    """What run.json says of the cameras and pairs from the result of a site-wide stage."""

    cameras: Mapping[str, Entry] = field(default_factory=dict)
    """Entry by field of a camera's record."""
    pairs: Mapping[str, Entry] = field(default_factory=dict)
    """Entry by field of a pair's record."""
    camera_notes: str = ""
    """Figure that maps cameras to a note."""
    lost_cameras: str = ""
    """Figure that maps cameras that could not be used to the reason."""

    def told_elsewhere(self) -> set[str]:
        """Figures that are told of each camera or pair, and not again of the whole."""
        return {entry.figure for entry in (*self.cameras.values(), *self.pairs.values())}


@dataclass(frozen=True)
class Stage:
    """One step of the pipeline."""

    name: str
    scope: Scope
    function: str
    """Dotted: package.module:function.  What it is handed is decided by the names of its arguments."""
    needs: Mapping[str, Need]
    """Inputs by argument name."""
    offers: Mapping[str, Need] = field(default_factory=dict)
    """Further inputs that another function in its place, or a method of it, may ask for by argument name."""
    role: Role | None = None
    optional: bool = False
    """The site file may switch it off."""
    unless_posed: bool = False
    """Has nothing to do where the site file gives every camera's intrinsics and pose."""
    dense: bool = False
    """Of pairs: works on the dense ones, rather than on those that are matched."""
    missing: Literal["failed", "skipped"] = "skipped"
    """What a task becomes when a needed input will not come."""
    method: Method | None = None
    section: str = ""
    """Its parameters are the section of this name of the site file."""
    site_parameters: tuple[str, ...] = ()
    """Parameters that are set at the top of the site file, by the same name."""
    component_parameter: str = ""
    """Done once for each component of cameras; this parameter says which."""
    lists: str = ""
    """Figure of its result that lists the pairs (of the pair graph, the dense ones) or the components (of the world)."""
    table: PointTable | None = None
    picture: Picture | None = None
    reports: Reports | None = None
    world_reports: WorldReports | None = None
    calibration: str = ""
    """Dotted function: the result -> the cameras that a run publishes, in the form of a calibration (JSON data)."""
    comments: str = ""
    """Dotted function: the result -> lines for the header of the product."""
    files: str = ""
    """Dotted function: the result -> names and bytes of files that a run publishes beside its cloud."""
    view: str = ""
    """Dotted function: the result -> its points for the report's 3-D view, as a stream of bytes."""
    layer: str = ""
    """Dotted function: the result -> a picture that lies on the report's map, as bytes (see `report.layers`)."""
    large: str = ""
    """Dotted function: the result of a camera -> a JPEG file's bytes, its picture as large as it is, for the report."""
    marks: str = ""
    """Dotted function: the result of a camera or a pair -> bytes: places in these pictures (see `report.seen`)."""
    title: str = ""
    """Of its part of the report, where a site-wide stage `reports`."""
    renamed: Mapping[str, Renamed] = field(default_factory=dict)
    held: Held | None = None
    kept: bool = True
    """The reference keeps its results."""
    judges: Judges | None = None
    pooled: str = ""
    """Dotted function: results of many nights, as a mapping by night -> one."""
    too_little: tuple[str, ...] = ()
    """Pairs are pooled that were rejected, here or by what rests on it, with one of these codes: one night had too little."""

    def needed(self) -> set[str]:
        """The stages without which it can do nothing."""
        return {need.stage for need in self.needs.values() if isinstance(need, FromStage) and not need.optional}

    @property
    def suffix(self) -> str:
        """Of its artifacts' files."""
        return self.table.suffix if self.table else ".wbf"
