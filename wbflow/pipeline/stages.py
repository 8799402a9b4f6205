"""The pipeline: its twenty stages in order, with their functions, their inputs, and the uses of their results.

To add a stage, write its function (`stages/`), its row here and, if run.json is to contain figures of it, its summary
(`pipeline.summaries`).  The engine knows the stages by name, but nothing about the contents of their arrays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

from wbflow_stages.contracts.camera_figures import DepthFigures, ExaminedHealth, FeaturesFigures, FrameFigures
from wbflow_stages.contracts.ground_figures import CloudFigures
from wbflow_stages.contracts.pair_figures import DisparityFigures, GeometryFigures, MatchesFigures, PairsFigures, RectifyFigures
from wbflow_stages.contracts.pose_figures import CalibrationCheck

from .summaries import ChangesSummary, CoverageSummary, ObservedSummary, PosesSummary

# names of the stages that the engine refers to; it treats all others alike
OBSERVED = "observed"
FRAMES = "frames"
HEALTH = "health"
FEATURES = "features"
PAIRS = "pairs"
MATCHES = "matches"
GEOMETRY = "geometry"
POSES = "poses"
DENSE_PAIRS = "dense_pairs"
RECTIFY = "rectify"
DISPARITY = "disparity"
CALIBRATION = "calibration"
DEPTH = "depth"
REFINE = "refine"
FUSE = "fuse"
CHANGES = "changes"

REJECTED = "wbflow_stages.types:Rejected"
"""The type of a result that means "nothing usable here": it has `reason` and `figures`."""

CHECK_RESULT = "wbflow_stages.types.checking:check_result"
"""The function that checks what a site's own function returned: (result, dotted name of the function, types that are needed)."""

RESULT_TYPES = {
    "observed": "wbflow_stages.types:ObservedPoses",
    "frames": "wbflow_stages.types:Frame",
    "health": "wbflow_stages.types:CameraHealth",
    "features": "wbflow_stages.types:Features",
    "overlap": "wbflow_stages.types:Overlap",
    "pairs": "wbflow.pipeline.pairs:PairGraph",
    "matches": "wbflow_stages.types:Matches",
    "geometry": "wbflow_stages.types:Geometry",
    "poses": "wbflow_stages.types:Poses",
    "scene": "wbflow_stages.types:Scene",
    "shared": "wbflow_stages.types:Overlap",
    "dense_pairs": "wbflow.pipeline.pairs:PairGraph",
    "rectify": "wbflow_stages.types:Rectification",
    "disparity": "wbflow_stages.types:Disparity",
    "calibration": "wbflow_stages.types:CalibrationCheck",
    "depth": "wbflow_stages.types:DepthMap",
    "refine": "wbflow_stages.types:DepthMap",
    "fuse": "wbflow_stages.types:Cloud",
    "coverage": "wbflow_stages.types:Coverage",
    "changes": "wbflow_stages.types:Changes",
}
"""What a site's own function for a stage must return, if not `REJECTED`.  Not read from the project's function, which would have
to be imported, with all libraries that it needs.  Of a stage without a row here, the contents alone are checked."""

SITE_TYPES = {
    "captures": "wbflow_stages.types:Capture",
    "mask": "wbflow_stages.types:Capture",
    "privacy": "wbflow_stages.types:Privacy",
    "lens": "wbflow_stages.types:Lens",
    "placement": "wbflow_stages.types:Placement",
    "survey": "wbflow_stages.contracts.stated:Survey",
    "observations": "wbflow_stages.types:Observations",
    "thing_survey": "wbflow_stages.types:ThingSurvey",
}
"""The inputs that the site file and the captures can provide to a stage, and their types."""

Scope = Literal["camera", "pair", "site"]
Of = Literal["own", "left", "right", "every", "cameras", "around", "near"]
Condition = Callable[[Any], bool]
"""A predicate of the site (`site.models.Site`)."""


@dataclass(frozen=True)
class Source:
    """Where an input of a stage comes from."""

    kind: Literal["stage", "site", "file", "reference", "history", "previous"]
    """Another stage; the site file or the captures; a file that the stage's section names; a stage's result in the reference's
    night (None or an empty mapping if there is no reference, or if tonight is the reference's night); earlier nights; the same
    stage's result on the newest earlier night with the same reference."""
    name: str
    """Name of the stage, or of the input from the site."""
    of: Of = "own"
    """Whose result: the task's own subject, or the left or right camera of its pair.  Or whose results, as a mapping: every
    subject, every camera as the site states it ("cameras": without the views of wide ones), the camera's partners in dense pairs
    ("around"), or these and some of their partners ("near": `Subjects.near`)."""
    part: str = ""
    """Only this field of the result; if it is a mapping from a site-wide stage, only the entry of the task's camera or pair."""
    optional: bool | Condition = False
    """The input may be missing: the function then gets None, or a mapping without some entries."""
    needed_if: Condition | None = None
    """If this is false for the site, the function gets an empty mapping."""
    unless: tuple[str, ...] = ()
    """The input may be missing if the inputs with these names are all present."""

    @property
    def joins(self) -> bool:
        """Is the input passed as a mapping?"""
        return self.of in {"every", "cameras", "around", "near"}

    def may_lack(self, site: Any) -> bool:
        """May the input be missing on this site?"""
        if callable(self.optional):
            return self.optional(site)
        return self.optional


own = partial(Source, "stage", of="own")
left = partial(Source, "stage", of="left")
right = partial(Source, "stage", of="right")
every = partial(Source, "stage", of="every")
around = partial(Source, "stage", of="around")
near = partial(Source, "stage", of="near")
site = partial(Source, "site")
reference = partial(Source, "reference")


@dataclass(frozen=True)
class Method:
    """A stage's choice among functions: one parameter names a row of a table, or any function as package.module:function."""

    parameter: str
    """Name of the parameter that selects the method."""
    table: str
    """Dotted name of a dictionary literal: name -> "package.module:function"."""
    inputs: tuple[str, ...] = ()
    """Names of arguments that the stage's function passes to its methods in addition to its inputs."""


@dataclass(frozen=True)
class Adapt:
    """A function that computes a stage's result from that of the reference, instead of the stage's own function."""

    function: str
    inputs: Mapping[str, Source]


@dataclass(frozen=True)
class Reuse:
    """How later nights use the reference's results of a stage."""

    shifted: Literal["reuse", "recompute"] | Adapt | None = None
    """Use of the reference's result if a camera has shifted by a known rotation; None: the result is never used."""
    moved: Literal["reuse", "recompute"] | Adapt | None = None
    """Use of the reference's result if a camera was moved or is new."""
    stored: bool = True
    """The reference keeps a copy of the results."""
    aggregate: str = ""
    """Dotted name of a function that pools the results of many nights (mapping by night) into one result."""
    too_little: tuple[str, ...] = ()
    """Rejection codes, of this stage or of pair stages that need it: one night was too little, so many nights are pooled."""


@dataclass(frozen=True)
class Products:
    """What people see of a stage's result: dotted names of the functions that make it from the result."""

    product_files: Mapping[str, str] = field(default_factory=dict)
    """Functions by name of the product file: the bytes they return are stored with the artifact.  `picture`: a JPEG, drawn from
    the result and `picture_inputs`; `large`: a camera's image in full size (JPEG); `marks`: a camera's or pair's points in
    `large`; `view`: points for the report's 3-D view; `layer`: an image on the report's map (see `report.pictures`); `cameras`:
    the cameras that a run publishes, as JSON in the format of a calibration."""
    picture_inputs: Mapping[str, Source] = field(default_factory=dict)
    """Further inputs of `picture` by argument name; the function gets None for a missing one."""
    files: str = ""
    """Function that yields names and bytes of the files that a run publishes with its cloud."""
    title: str = ""
    """Title of the stage's section in the report, if its summary is a `SiteSummary`."""


@dataclass(frozen=True)
class Stage:
    """One step of the pipeline."""

    name: str
    scope: Scope
    function: str
    """Dotted name, package.module:function.  The names of the function's arguments select its inputs."""
    inputs: Mapping[str, Source]
    """Inputs by argument name."""
    offers: Mapping[str, Source] = field(default_factory=dict)
    """Further inputs, for methods and functions of a site's own that have arguments with these names."""
    optional: bool | Condition = False
    """The site file may switch the stage off; if it is a condition, the stage is off for sites that do not meet it, too."""
    dense: bool = False
    """Of a pair stage: it works on the dense pairs instead of the matched ones."""
    method: Method | None = None
    site_keys: tuple[str, ...] = ()
    """Keys of the site file outside of `stages` that set parameters of the stage: "resolution", "pairs.degree"."""
    reuse: Reuse = Reuse()
    products: Products = Products()
    summary: type[Any] | None = None
    """The part of its results that the engine reads and run.json contains: figures of the contracts, or these with what the
    engine adds."""

    @property
    def sources(self) -> dict[str, Source]:
        """All inputs that it can provide to a function, by argument name."""
        return {**self.inputs, **self.offers}

    @property
    def files(self) -> list[str]:
        """The inputs that are files, which its section in the site file names."""
        return [name for name, source in self.offers.items() if source.kind == "file"]

    def needed(self) -> set[str]:
        """The stages whose results this one requires."""
        return {source.name for source in self.inputs.values() if source.kind == "stage" and not source.optional}

    def set_by_site(self) -> dict[str, str]:
        """Return, by parameter, the key of the site file that sets it outside of `stages`."""
        return {key.rpartition(".")[2]: key for key in self.site_keys}


CLOUD_COLUMNS = "wbflow_stages.io.clouds:cloud_columns"
"""The function that gives a cloud's columns by name: clouds are stored as PLY files."""
RESTORE_CLOUD = "wbflow_stages.io.clouds:cloud_of"
"""The function that gives a cloud from its columns."""
COMPONENT = "component"
"""The parameter of `fuse` with the number of the component of cameras; each component has a task."""

_SIDE_FEATURES = {"left": left("features"), "right": right("features")}
_SIDE_FRAMES = {"left": left("frames"), "right": right("frames")}
_PAIR_FRAMES = {"left_frame": left("frames"), "right_frame": right("frames")}
_PAIR_FEATURES = {"left_features": left("features"), "right_features": right("features")}
_VIEWS = every("frames", part="view")
_SURFACE = {
    "frames": every("frames"),
    "depths": every("depth"),
    "refined": every("refine", optional=True),
    "scene": own("scene", optional=True),
}
_REFERENCE_SURFACE = {
    "reference_poses": reference("poses"),
    "reference_cloud": reference("fuse"),
    "reference_frames": reference("frames", of="every"),
    "reference_depths": reference("depth", of="every"),
    "reference_refined": reference("refine", of="every"),
}
_PREVIOUS_CHANGES = {"previous": Source("previous", "changes"), "used_ids": Source("previous", "used_ids")}
_PAIR_KEYS = ("pairs.degree", "pairs.min_angle", "pairs.max_angle", "pairs.include", "pairs.exclude")
_ALWAYS_REUSED = Reuse(shifted="reuse", moved="reuse")
"""For results that do not depend on the orientation of single cameras."""
_TURNED_GEOMETRY = Adapt(
    "wbflow_stages.reference_reuse:turn_geometry",
    {"pinned": reference("geometry"), "left": left("health"), "right": right("health")},
)
_HELD_POSES = Adapt(
    "wbflow_stages.reference_reuse:hold_poses",
    {
        "pinned": reference("poses"),
        "healths": every("health"),
        "views": _VIEWS,
        "geometries": every("geometry", optional=True),
        "survey": site("survey"),
    },
)
"""Keeps the cameras of the reference; turns those that have shifted, and solves those that were moved from the others."""


_OBSERVED = own("observed", optional=True)
"""Poses from observations of things, where a site has any."""


def _some_unposed(site: Any) -> bool:
    return not site.posed


def _has_observations(site: Any) -> bool:
    return site.observations is not None


def _may_do_without_matches(site: Any) -> bool:
    return site.has_stated_poses or _has_observations(site)


STAGES: tuple[Stage, ...] = (
    Stage(
        "observed",
        scope="site",
        function="wbflow_stages.observed_poses:solve_observations",
        inputs={
            "observations": site("observations"),
            "lenses": site("lens", of="cameras"),
            "placements": site("placement", of="cameras"),
            "thing_survey": site("thing_survey"),
            "survey": site("survey"),
        },
        optional=_has_observations,
        products=Products({"view": "wbflow_stages.exports.view:track_view"}, title="How observations place the cameras"),
        summary=ObservedSummary,
    ),
    Stage(
        "frames",
        scope="camera",
        function="wbflow_stages.frames:clean_frame",
        inputs={
            "captures": site("captures"),
            "lens": site("lens"),
            "mask": site("mask", optional=True),
            "privacy": site("privacy", optional=True),
        },
        site_keys=("resolution",),
        products=Products(
            {"picture": "wbflow_stages.exports.previews:frame_preview", "large": "wbflow_stages.exports.previews:frame_large"}
        ),
        summary=FrameFigures,
    ),
    Stage(
        "health",
        scope="camera",
        function="wbflow_stages.health:examine",
        inputs={
            "frame": own("frames"),
            "pinned_frame": reference("frames"),
            "pinned_camera": reference("poses", part="cameras"),
            "history": Source("history", "shifts"),
        },
        offers={"pinned_features": reference("features")},
        optional=True,
        site_keys=("health.nudged_px", "health.moved_deg", "health.flat", "health.dark"),
        reuse=Reuse(stored=False),
        summary=ExaminedHealth,
    ),
    Stage(
        "features",
        scope="camera",
        function="wbflow_stages.features:detect",
        inputs={"frame": own("frames")},
        offers={"model": Source("file", "model")},
        method=Method("detector", "wbflow_stages.features:DETECTORS"),
        reuse=Reuse(shifted="reuse", moved="recompute"),
        products=Products({"marks": "wbflow_stages.exports.previews:keypoint_marks"}),
        summary=FeaturesFigures,
    ),
    Stage(
        "overlap",
        scope="site",
        function="wbflow_stages.overlap:estimate_overlap",
        inputs={
            "views": _VIEWS,
            "placements": site("placement", of="every"),
            "features": every("features", needed_if=_some_unposed),
            "observed": _OBSERVED,
        },
        offers={"frames": every("frames")},
        reuse=_ALWAYS_REUSED,
    ),
    Stage(
        "pairs",
        scope="site",
        function="wbflow.pipeline.pairs:select_pairs",
        inputs={"overlap": own("overlap")},
        site_keys=_PAIR_KEYS,
        reuse=_ALWAYS_REUSED,
        summary=PairsFigures,
    ),
    Stage(
        "matches",
        scope="pair",
        function="wbflow_stages.matches:match",
        inputs=_SIDE_FEATURES,
        offers={**_PAIR_FRAMES, "model": Source("file", "model")},
        method=Method("matcher", "wbflow_stages.matches:MATCHERS"),
        reuse=Reuse(
            shifted="reuse",
            moved="recompute",
            aggregate="wbflow_stages.other_nights:pool_matches",
            too_little=("too-few-matches", "too-few-inliers", "clustered"),
        ),
        summary=MatchesFigures,
    ),
    Stage(
        "geometry",
        scope="pair",
        function="wbflow_stages.geometry:estimate_geometry",
        inputs={"matches": own("matches"), **_SIDE_FEATURES},
        offers=_PAIR_FRAMES,
        reuse=Reuse(shifted=_TURNED_GEOMETRY, moved="recompute"),
        products=Products(
            {"picture": "wbflow_stages.exports.previews:matches_preview", "marks": "wbflow_stages.exports.previews:inlier_marks"},
            picture_inputs=_SIDE_FRAMES,
        ),
        summary=GeometryFigures,
    ),
    Stage(
        "poses",
        scope="site",
        function="wbflow_stages.poses:solve_poses",
        inputs={
            "views": _VIEWS,
            "placements": site("placement", of="every"),
            "geometries": every("geometry", optional=_may_do_without_matches),
            "survey": site("survey"),
            "frames_if_rough": every("frames", needed_if=lambda site: site.has_rough_pose or _has_observations(site)),
            "observed": _OBSERVED,
        },
        offers={"frames": every("frames"), "features": every("features")},
        optional=True,
        reuse=Reuse(shifted=_HELD_POSES, moved=_HELD_POSES),
        products=Products({"cameras": "wbflow_stages.io.cameras:calibration_file"}),
        summary=PosesSummary,
    ),
    Stage(
        "scene",
        scope="site",
        function="wbflow_stages.scene:find_scene",
        inputs={"frames": every("frames"), "cameras": own("poses", part="cameras")},
        optional=True,
        site_keys=("bounds",),
        reuse=_ALWAYS_REUSED,
    ),
    Stage(
        "shared",
        scope="site",
        function="wbflow_stages.shared:find_shared",
        inputs={"poses": own("poses")},
        optional=_some_unposed,
        reuse=_ALWAYS_REUSED,
    ),
    Stage(
        "dense_pairs",
        scope="site",
        function="wbflow.pipeline.pairs:select_dense_pairs",
        inputs={"shared": own("shared"), "pairs": own("pairs")},
        optional=_some_unposed,
        site_keys=_PAIR_KEYS,
        reuse=_ALWAYS_REUSED,
        summary=PairsFigures,
    ),
    Stage(
        "rectify",
        scope="pair",
        dense=True,
        function="wbflow_stages.rectify:rectify",
        inputs={
            "geometry": own("geometry", unless=("left", "right")),
            "left": left("poses", part="cameras", optional=True),
            "right": right("poses", part="cameras", optional=True),
            "check": own("poses", part="pair_checks", optional=True),
            **_PAIR_FRAMES,
            "scene": own("scene", optional=True),
        },
        offers=_PAIR_FEATURES,
        method=Method("method", "wbflow_stages.rectify:METHODS", inputs=("pair",)),
        reuse=Reuse(shifted="recompute", moved="recompute"),
        summary=RectifyFigures,
    ),
    Stage(
        "disparity",
        scope="pair",
        dense=True,
        function="wbflow_stages.disparity:match_dense",
        inputs={
            **_SIDE_FRAMES,
            "rectification": own("rectify"),
            "reference_rectification": reference("rectify"),
            "reference_disparity": reference("disparity"),
        },
        offers={"geometry": own("geometry"), **_PAIR_FEATURES},
        method=Method("matcher", "wbflow_stages.disparity:MATCHERS", inputs=("pair",)),
        products=Products(
            {"picture": "wbflow_stages.exports.previews:disparity_preview"},
            picture_inputs={**_SIDE_FRAMES, "rectification": own("rectify")},
        ),
        summary=DisparityFigures,
    ),
    Stage(
        "calibration",
        scope="site",
        function="wbflow_stages.calibration:check_calibration",
        inputs={"poses": own("poses"), "disparities": every("disparity", optional=True)},
        optional=_may_do_without_matches,
        reuse=Reuse(stored=False),
        summary=CalibrationCheck,
    ),
    Stage(
        "depth",
        scope="camera",
        function="wbflow_stages.depth:view_depth",
        inputs={
            "camera": own("poses", part="cameras"),
            "cameras": around("poses", part="cameras"),
            "rectifications": around("rectify"),
            "disparities": around("disparity"),
        },
        offers={"frame": own("frames"), "frames": around("frames")},
        reuse=Reuse(aggregate="wbflow_stages.other_nights:pool_depths"),
        summary=DepthFigures,
    ),
    Stage(
        "refine",
        scope="camera",
        function="wbflow_stages.refine:refine",
        inputs={
            "frame": own("frames"),
            "camera": own("poses", part="cameras"),
            "depth": own("depth"),
            "frames": near("frames"),
            "cameras": near("poses", part="cameras"),
            "depths": near("depth", optional=True),
            "reference_camera": reference("poses", part="cameras"),
            "reference_depth": reference("refine"),
        },
        optional=True,
        reuse=Reuse(aggregate="wbflow_stages.other_nights:pool_depths"),
        products=Products({"picture": "wbflow_stages.exports.previews:depth_preview"}),
    ),
    Stage(
        "fuse",
        scope="site",
        function="wbflow_stages.fuse:fuse",
        inputs={
            "frames": every("frames"),
            "cameras": own("poses", part="cameras"),
            "depths": every("depth"),
            "refined": every("refine", optional=True),
        },
        products=Products(
            {"picture": "wbflow_stages.exports.previews:cloud_preview", "view": "wbflow_stages.exports.view:cloud_view"},
            picture_inputs={"cameras": own("poses", part="cameras")},
        ),
        summary=CloudFigures,
    ),
    Stage(
        "coverage",
        scope="site",
        function="wbflow_stages.coverage:find_coverage",
        inputs={"poses": own("poses"), **_SURFACE},
        optional=True,
        reuse=Reuse(stored=False),
        products=Products(
            {"picture": "wbflow_stages.exports.ground:coverage_preview", "layer": "wbflow_stages.exports.ground:coverage_layer"},
            picture_inputs={"poses": own("poses")},
            files="wbflow_stages.exports.ground:coverage_files",
            title="What the cameras see of the ground",
        ),
        summary=CoverageSummary,
    ),
    Stage(
        "changes",
        scope="site",
        function="wbflow_stages.changes:find_changes",
        inputs={"poses": own("poses"), "cloud": own("fuse"), **_SURFACE, **_REFERENCE_SURFACE, **_PREVIOUS_CHANGES},
        optional=True,
        site_keys=("zones",),
        reuse=Reuse(stored=False),
        products=Products(
            {"picture": "wbflow_stages.exports.ground:changes_preview", "view": "wbflow_stages.exports.view:changes_view"},
            files="wbflow_stages.exports.ground:changes_files",
            title="What has changed",
        ),
        summary=ChangesSummary,
    ),
)

_BY_NAME = {stage.name: stage for stage in STAGES}


def stage_named(name: str) -> Stage:
    """Return the row of a stage.  Raises KeyError."""
    return _BY_NAME[name]


def ancestors(name: str) -> set[str]:
    """Return the names of a stage and of all stages that it needs, directly or not."""
    names: set[str] = set()
    pending = [name]
    while pending:
        stage = stage_named(pending.pop())
        if stage.name in names:
            continue
        names.add(stage.name)
        pending += [source.name for source in stage.inputs.values() if source.kind == "stage"]
        # besides its inputs: which pairs there are, and whether the reference's result can be used
        if stage.scope == "pair":
            pending.append(DENSE_PAIRS if stage.dense else PAIRS)
        if stage.reuse.shifted:
            pending.append(HEALTH)
    return names
