"""The table of stages: what each works on, what it needs, and the function that does it.

The one place of the engine that names stages, stage functions, and what is in their results.  Everything else asks a row, or asks
for the stage that plays a role.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Any, Literal

Scope = Literal["camera", "pair", "site"]

REJECTED = "wbflow_stages.types:Rejected"
"""The type of a result that says "nothing usable here": it has `reason` and `figures`."""


class Role(Enum):
    """What the engine needs a stage for, besides handing on its result."""

    FRAME = auto()
    """The night's view of a camera: without it the camera is lost."""
    PAIR_GRAPH = auto()
    """Says which pairs of cameras are matched."""
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
    """Of the cameras that the one in question makes pairs with, and of these pairs, as a mapping."""


class SiteValue(Enum):
    """What a site file and its captures can give to a stage, and the type that it is handed over as."""

    CAPTURES = "captures", "wbflow_stages.types:Capture"
    """The capture files of a camera, as they are: a list."""
    MASK = "mask", "wbflow_stages.types:Capture"
    """The mask file of a camera, as it is."""
    LENS = "lens", "wbflow_stages.types:Lens"
    """Intrinsics of a camera."""
    PLACEMENT = "placement", "wbflow_stages.types:Placement"
    """Pose of a camera."""
    SURVEY = "survey", "wbflow_stages.types:Survey"
    """Distances, control points and coordinate system of the site."""

    @property
    def kind(self) -> str:
        """Dotted name of the type."""
        return self.value[1]


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


@dataclass(frozen=True)
class FromSite:
    """An input that the site file or the captures give."""

    value: SiteValue
    which: Which = Which.SAME
    optional: bool = False


Need = FromStage | FromSite


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
class Reports:
    """What run.json says of a stage's results.  A camera or pair whose task has no result is not ok."""

    fields: Mapping[str, str] = field(default_factory=dict)
    """Figure by field of the camera's or pair's record."""
    rejected: Mapping[str, str] = field(default_factory=dict)
    """The same, of a rejection."""
    notes: str = ""
    """Figure that holds notes for the operator."""


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
    missing: Literal["failed", "skipped"] = "skipped"
    """What a task becomes when a needed input will not come."""
    method: Method | None = None
    pair_settings: bool = False
    """Its parameters are the section `pairs` of the site file."""
    resolution_parameter: str = ""
    """The parameter that the site file's `resolution` is."""
    component_parameter: str = ""
    """Done once for each component of cameras; this parameter says which."""
    lists: str = ""
    """Figure of its result that lists the pairs (of the pair graph) or the components (of the world)."""
    table: PointTable | None = None
    picture: Picture | None = None
    reports: Reports | None = None
    world_reports: WorldReports | None = None
    publishes: Mapping[str, str] = field(default_factory=dict)
    """Files of a run's folder: name -> dotted function that makes JSON data of the result."""
    comments: str = ""
    """Dotted function: the result -> lines for the header of the product."""
    renamed: Mapping[str, Renamed] = field(default_factory=dict)

    @property
    def suffix(self) -> str:
        """Of its artifacts' files."""
        return self.table.suffix if self.table else ".wbf"


_SIDES: dict[str, Need] = {"left": FromStage("features", Which.LEFT), "right": FromStage("features", Which.RIGHT)}
_FRAMES: dict[str, Need] = {"left": FromStage("frames", Which.LEFT), "right": FromStage("frames", Which.RIGHT)}
_FRAMES_TOO: dict[str, Need] = {f"{side}_frame": need for side, need in _FRAMES.items()}
_FEATURES_TOO: dict[str, Need] = {f"{side}_features": need for side, need in _SIDES.items()}
_PLACEMENTS = FromSite(SiteValue.PLACEMENT, Which.ALL)
_VIEWS = FromStage("frames", Which.ALL, Part("view"))

STAGES: tuple[Stage, ...] = (
    Stage(
        "frames",
        scope="camera",
        function="wbflow_stages.frames:clean_frame",
        needs={
            "captures": FromSite(SiteValue.CAPTURES),
            "lens": FromSite(SiteValue.LENS),
            "mask": FromSite(SiteValue.MASK, optional=True),
        },
        role=Role.FRAME,
        missing="failed",
        resolution_parameter="resolution",
        picture=Picture("wbflow_stages.io.previews:frame_preview"),
        reports=Reports(notes="notes"),
    ),
    Stage(
        "features",
        scope="camera",
        function="wbflow_stages.features:detect",
        needs={"frame": FromStage("frames")},
        reports=Reports({"keypoints": "xy_count"}, notes="notes"),
    ),
    Stage(
        "overlap",
        scope="site",
        function="wbflow_stages.overlap:estimate_overlap",
        needs={
            "views": _VIEWS,
            "placements": _PLACEMENTS,
            "features": FromStage("features", Which.ALL, unless_posed=True),
        },
        offers={"frames": FromStage("frames", Which.ALL)},
    ),
    Stage(
        "pairs",
        scope="site",
        function="wbflow.graph.pairs:select_pairs",
        needs={"overlap": FromStage("overlap")},
        role=Role.PAIR_GRAPH,
        pair_settings=True,
        lists="pairs",
    ),
    Stage(
        "matches",
        scope="pair",
        function="wbflow_stages.matches:match",
        needs=_SIDES,
        offers=_FRAMES_TOO,
        role=Role.MATCHES,
        reports=Reports({"matches": "x1_count"}),
    ),
    Stage(
        "geometry",
        scope="pair",
        function="wbflow_stages.geometry:estimate_geometry",
        needs={"matches": FromStage("matches"), **_SIDES},
        offers=_FRAMES_TOO,
        role=Role.GEOMETRY,
        picture=Picture("wbflow_stages.io.previews:matches_preview", _FRAMES),
        reports=Reports(
            {
                "inliers": "x1_count",
                "angle_deg": "angle_deg",
                "epipolar_px": "epipolar_px",
                "probability": "good_probability",
            },
            rejected={"inliers": "inliers"},
        ),
    ),
    Stage(
        "poses",
        scope="site",
        function="wbflow_stages.poses:solve_poses",
        needs={
            "views": _VIEWS,
            "placements": _PLACEMENTS,
            "geometries": FromStage("geometry", Which.ALL),
            "survey": FromSite(SiteValue.SURVEY),
        },
        offers={"frames": FromStage("frames", Which.ALL), "features": FromStage("features", Which.ALL)},
        role=Role.WORLD,
        optional=True,
        lists="components",
        world_reports=WorldReports(
            cameras={"pose": Entry("checks")},
            pairs={"poses_px": Entry("verdicts", "adjusted_px")},
            camera_notes="suspects",
            lost_cameras="unsolved",
        ),
        publishes={"cameras.json": "wbflow_stages.io.cameras:calibration"},
        comments="wbflow_stages.io.cameras:place_comments",
    ),
    Stage(
        "rectify",
        scope="pair",
        function="wbflow_stages.rectify:rectify",
        needs={
            "geometry": FromStage("geometry"),
            "left": FromStage("poses", Which.LEFT, Part("cameras"), optional=True),
            "right": FromStage("poses", Which.RIGHT, Part("cameras"), optional=True),
            "verdict": FromStage("poses", part=Part("verdicts"), optional=True),
        },
        offers=_FRAMES_TOO | _FEATURES_TOO,
        role=Role.RECTIFICATION,
        reports=Reports({"angle_deg": "angle_deg", "vertical_px": "vertical_px", "method": "method"}),
    ),
    Stage(
        "disparity",
        scope="pair",
        function="wbflow_stages.disparity:match_dense",
        needs={**_FRAMES, "rectification": FromStage("rectify")},
        offers={"geometry": FromStage("geometry"), **_FEATURES_TOO},
        role=Role.DISPARITY,
        picture=Picture("wbflow_stages.io.previews:disparity_preview"),
        reports=Reports({"density": "density"}),
    ),
    Stage(
        "depth",
        scope="camera",
        function="wbflow_stages.depth:view_depth",
        needs={
            "camera": FromStage("poses", part=Part("cameras")),
            "cameras": FromStage("poses", Which.AROUND, Part("cameras")),
            "rectifications": FromStage("rectify", Which.AROUND),
            "disparities": FromStage("disparity", Which.AROUND),
        },
        offers={"frame": FromStage("frames"), "frames": FromStage("frames", Which.AROUND)},
        role=Role.DEPTH,
    ),
    Stage(
        "refine",
        scope="camera",
        function="wbflow_stages.refine:refine",
        needs={
            "frame": FromStage("frames"),
            "camera": FromStage("poses", part=Part("cameras")),
            "depth": FromStage("depth"),
            "frames": FromStage("frames", Which.AROUND),
            "cameras": FromStage("poses", Which.AROUND, Part("cameras")),
        },
        role=Role.REFINED_DEPTH,
        picture=Picture("wbflow_stages.io.previews:depth_preview"),
        optional=True,
    ),
    Stage(
        "fuse",
        scope="site",
        function="wbflow_stages.fuse:fuse",
        needs={
            "frames": FromStage("frames", Which.ALL),
            "cameras": FromStage("poses", part=Part("cameras")),
            "depths": FromStage("depth", Which.ALL),
            "refined": FromStage("refine", Which.ALL, optional=True),
        },
        role=Role.PRODUCT,
        component_parameter="component",
        table=PointTable(
            columns="wbflow_stages.io.clouds:cloud_columns",
            restore="wbflow_stages.io.clouds:cloud_of",
            figures="wbflow_stages.io.clouds:cloud_figures",
        ),
        picture=Picture("wbflow_stages.io.previews:cloud_preview"),
    ),
)

_BY_NAME = {stage.name: stage for stage in STAGES}
_BY_ROLE = {stage.role: stage for stage in STAGES if stage.role}


def stage_named(name: str) -> Stage:
    """The row of a stage.  Raises KeyError."""
    return _BY_NAME[name]


def stage_with(role: Role) -> Stage:
    """The row of the stage that plays a role."""
    return _BY_ROLE[role]


def ancestors(name: str) -> set[str]:
    """Names of a stage and of all stages that it needs, directly or not."""
    found: set[str] = set()
    waiting = [name]
    while waiting:
        stage = stage_named(waiting.pop())
        if stage.name not in found:
            found.add(stage.name)
            waiting += [need.stage for need in stage.needs.values() if isinstance(need, FromStage)]
            if stage.scope == "pair":
                waiting.append(stage_with(Role.PAIR_GRAPH).name)
    return found
