"""The pipeline: its nineteen stages in their order, with their inputs, their functions, and what becomes of their results.

To add a stage, write its function (`stages/`), its row here, and where run.json is to have figures of it, its summary
(`pipeline.summaries`).  The engine knows the stages by name; what is in their arrays it does not know.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Literal

from . import summaries

FRAMES, HEALTH, PAIRS, MATCHES, GEOMETRY = "frames", "health", "pairs", "matches", "geometry"
POSES, DENSE_PAIRS, RECTIFY, DISPARITY = "poses", "dense_pairs", "rectify", "disparity"
CALIBRATION, DEPTH, REFINE, FUSE, CHANGES = "calibration", "depth", "refine", "fuse", "changes"
"""Names of the stages that the engine knows for more than handing on their results."""

REJECTED = "wbflow_stages.types:Rejected"
"""The type of a result that says "nothing usable here": it has `reason` and `figures`."""

SITE_TYPES = {
    "captures": "wbflow_stages.types:Capture",
    "mask": "wbflow_stages.types:Capture",
    "privacy": "wbflow_stages.types:Privacy",
    "lens": "wbflow_stages.types:Lens",
    "placement": "wbflow_stages.types:Placement",
    "survey": "wbflow_stages.types:Survey",
}
"""What the site file and its captures can give to a stage, and the type that it comes as."""

Scope = Literal["camera", "pair", "site"]
Of = Literal["own", "left", "right", "every", "around", "near"]
Condition = Callable[[Any], bool]
"""A question to the site (`site.models.Site`)."""


@dataclass(frozen=True)
class Source:
    """Where an input of a stage comes from."""

    kind: Literal["stage", "site", "file", "reference", "history"]
    """Another stage; the site file or the captures; a file that the stage's section names; what a stage made in the reference's
    night (None, or an empty mapping, where there is no reference, or where tonight is its own night); earlier nights."""
    name: str
    """Of the stage, or of what the site gives."""
    of: Of = "own"
    """The task's own subject; the left or right camera of the pair; every subject that has it, as a mapping; the cameras that the
    one in question makes dense pairs with ("around"), and a few that make pairs with these ("near", see `Subjects.near`)."""
    part: str = ""
    """Only this field of the result; of a mapping that a site-wide stage made, the entry of the camera or pair in question."""
    optional: bool | Condition = False
    """It may be missing: then the function gets None, or a mapping that lacks entries."""
    needed_if: Condition | None = None
    """Where this is not so, the function gets an empty mapping."""
    unless: tuple[str, ...] = ()
    """It may be missing where the inputs of these names are there."""

    @property
    def joins(self) -> bool:
        """Is it handed over as a mapping?"""
        return self.of in {"every", "around", "near"}

    def may_lack(self, site: Any) -> bool:
        """May it be missing on this site?"""
        return self.optional(site) if callable(self.optional) else self.optional


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
    """The parameter that chooses."""
    table: str
    """Dotted name of a dictionary literal: name -> "package.module:function"."""
    given: tuple[str, ...] = ()
    """Names of arguments that the stage itself hands to its methods, besides its inputs."""


@dataclass(frozen=True)
class Adapt:
    """Another function for a stage, that makes its result from the reference's."""

    function: str
    inputs: Mapping[str, Source]


@dataclass(frozen=True)
class Reuse:
    """What the reference has to do with a stage's results."""

    shifted: Literal["reuse", "recompute"] | Adapt | None = None
    """What becomes of the reference's result where a camera has shifted by a known rotation; None: it is never used."""
    moved: Literal["reuse", "recompute"] | Adapt | None = None
    """The same where a camera was moved, or is new."""
    stored: bool = True
    """The reference keeps a copy of the results."""
    aggregate: str = ""
    """Dotted function: results of many nights, as a mapping by night -> one."""
    too_little: tuple[str, ...] = ()
    """Pairs are aggregated that were rejected, here or by what rests on it, with one of these codes: one night had too little."""


@dataclass(frozen=True)
class Products:
    """What is made of a stage's result for people; of each, the dotted function that makes it of the result."""

    drawings: Mapping[str, str] = field(default_factory=dict)
    """Bytes that are kept beside the artifact, by name.  `picture`: a JPEG file, of the result and `picture_inputs`; `large`: one
    of a camera's picture as large as it is; `marks`: places in these pictures, of a camera or a pair; `view`: points for the
    report's 3-D view; `layer`: a picture that lies on its map (see `report.pictures`); `cameras`: those that a run publishes, as
    JSON in the form of a calibration."""
    picture_inputs: Mapping[str, Source] = field(default_factory=dict)
    """By argument name; None is passed for one that is not there."""
    files: str = ""
    """Names and bytes of files that a run publishes beside its cloud."""
    title: str = ""
    """Of its part of the report, where its summary is a `SiteSummary`."""


@dataclass(frozen=True)
class Stage:
    """One step of the pipeline."""

    name: str
    scope: Scope
    function: str
    """Dotted: package.module:function.  What it is handed is decided by the names of its arguments."""
    inputs: Mapping[str, Source]
    """By argument name."""
    offers: Mapping[str, Source] = field(default_factory=dict)
    """Further inputs that another function in its place, or a method of it, may ask for by argument name."""
    optional: bool | Condition = False
    """The site file may switch it off; of a condition: it has nothing to do where this is not so, either."""
    dense: bool = False
    """Of pairs: works on the dense ones, rather than on those that are matched."""
    method: Method | None = None
    site_keys: tuple[str, ...] = ()
    """Where the site file sets parameters of it outside of `stages`: "resolution", "pairs.degree"."""
    reuse: Reuse = Reuse()
    products: Products = Products()
    summary: type[summaries.Summary] | None = None
    """What the engine and run.json read of its results."""

    def needed(self) -> set[str]:
        """The stages without which it can do nothing."""
        return {source.name for source in self.inputs.values() if source.kind == "stage" and not source.optional}

    def set_by_site(self) -> dict[str, str]:
        """Return the key of the site file that sets each parameter which is not set in `stages`."""
        return {key.rpartition(".")[2]: key for key in self.site_keys}


CLOUD_COLUMNS = "wbflow_stages.io.clouds:cloud_columns"
RESTORE_CLOUD = "wbflow_stages.io.clouds:cloud_of"
CLOUD_FIGURES = "wbflow_stages.io.clouds:cloud_figures"
"""A cloud is kept as a PLY file: its columns by name, the cloud of such columns, and figures beside its fields."""
COMPONENT = "component"
"""The parameter of `fuse` that says which component of cameras it works on; each has a task."""

_SIDES = {"left": left("features"), "right": right("features")}
_FRAMES = {"left": left("frames"), "right": right("frames")}
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
_PAIR_KEYS = ("pairs.degree", "pairs.min_angle", "pairs.max_angle", "pairs.include", "pairs.exclude")
_ALWAYS = Reuse(shifted="reuse", moved="reuse")
"""Of results that do not depend on where single cameras look."""
_FEATURES = Reuse(shifted="reuse", moved="recompute")
_TURNED_GEOMETRY = Adapt(
    "wbflow_stages.held:turn_geometry", {"pinned": reference("geometry"), "left": left("health"), "right": right("health")}
)
_HELD_POSES = Adapt(
    "wbflow_stages.held:hold_poses",
    {
        "pinned": reference("poses"),
        "healths": every("health"),
        "views": _VIEWS,
        "geometries": every("geometry", optional=True),
        "survey": site("survey"),
    },
)
"""The cameras of the reference stay; one that has shifted is turned, one that was moved is solved from the others."""


def _some_unposed(site: Any) -> bool:
    return not site.posed


STAGES: tuple[Stage, ...] = (
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
        summary=summaries.FrameSummary,
    ),
    Stage(
        "health",
        scope="camera",
        function="wbflow_stages.health:examine",
        inputs={
            "frame": own("frames"),
            "pinned_frame": reference("frames"),
            "pinned_camera": reference("poses", part="cameras"),
            "usual": Source("history", "shifts"),
        },
        offers={"pinned_features": reference("features")},
        optional=True,
        site_keys=("health.nudged_px", "health.moved_deg", "health.flat", "health.dark"),
        reuse=Reuse(stored=False),
        summary=summaries.HealthSummary,
    ),
    Stage(
        "features",
        scope="camera",
        function="wbflow_stages.features:detect",
        inputs={"frame": own("frames")},
        reuse=_FEATURES,
        products=Products({"marks": "wbflow_stages.exports.previews:keypoint_marks"}),
        summary=summaries.FeaturesSummary,
    ),
    Stage(
        "overlap",
        scope="site",
        function="wbflow_stages.overlap:estimate_overlap",
        inputs={
            "views": _VIEWS,
            "placements": site("placement", of="every"),
            "features": every("features", needed_if=_some_unposed),
        },
        offers={"frames": every("frames")},
        reuse=_ALWAYS,
    ),
    Stage(
        "pairs",
        scope="site",
        function="wbflow.pipeline.pairs:select_pairs",
        inputs={"overlap": own("overlap")},
        site_keys=_PAIR_KEYS,
        reuse=_ALWAYS,
        summary=summaries.PairsSummary,
    ),
    Stage(
        "matches",
        scope="pair",
        function="wbflow_stages.matches:match",
        inputs=_SIDES,
        offers={**_PAIR_FRAMES, "model": Source("file", "model")},
        method=Method("matcher", "wbflow_stages.matches:MATCHERS"),
        reuse=Reuse(
            shifted="reuse",
            moved="recompute",
            aggregate="wbflow_stages.pooled:pool_matches",
            too_little=("too-few-matches", "too-few-inliers", "clustered"),
        ),
        summary=summaries.MatchesSummary,
    ),
    Stage(
        "geometry",
        scope="pair",
        function="wbflow_stages.geometry:estimate_geometry",
        inputs={"matches": own("matches"), **_SIDES},
        offers=_PAIR_FRAMES,
        reuse=Reuse(shifted=_TURNED_GEOMETRY, moved="recompute"),
        products=Products(
            {"picture": "wbflow_stages.exports.previews:matches_preview", "marks": "wbflow_stages.exports.previews:inlier_marks"},
            picture_inputs=_FRAMES,
        ),
        summary=summaries.GeometrySummary,
    ),
    Stage(
        "poses",
        scope="site",
        function="wbflow_stages.poses:solve_poses",
        inputs={
            "views": _VIEWS,
            "placements": site("placement", of="every"),
            "geometries": every("geometry", optional=lambda site: site.some_given),
            "survey": site("survey"),
            "frames_if_rough": every("frames", needed_if=lambda site: site.rough),
        },
        offers={"frames": every("frames"), "features": every("features")},
        optional=True,
        reuse=Reuse(shifted=_HELD_POSES, moved=_HELD_POSES),
        products=Products({"cameras": "wbflow_stages.io.cameras:calibration_file"}),
        summary=summaries.PosesSummary,
    ),
    Stage(
        "scene",
        scope="site",
        function="wbflow_stages.scene:find_scene",
        inputs={"frames": every("frames"), "cameras": own("poses", part="cameras")},
        optional=True,
        site_keys=("bounds",),
        reuse=_ALWAYS,
    ),
    Stage(
        "shared",
        scope="site",
        function="wbflow_stages.shared:find_shared",
        inputs={"poses": own("poses")},
        optional=_some_unposed,
        reuse=_ALWAYS,
    ),
    Stage(
        "dense_pairs",
        scope="site",
        function="wbflow.pipeline.pairs:select_dense_pairs",
        inputs={"shared": own("shared"), "pairs": own("pairs")},
        optional=_some_unposed,
        site_keys=_PAIR_KEYS,
        reuse=_ALWAYS,
        summary=summaries.PairsSummary,
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
        method=Method("method", "wbflow_stages.rectify:METHODS", given=("pair",)),
        reuse=Reuse(shifted="recompute", moved="recompute"),
        summary=summaries.RectifySummary,
    ),
    Stage(
        "disparity",
        scope="pair",
        dense=True,
        function="wbflow_stages.disparity:match_dense",
        inputs={
            **_FRAMES,
            "rectification": own("rectify"),
            "reference_rectification": reference("rectify"),
            "reference_disparity": reference("disparity"),
        },
        offers={"geometry": own("geometry"), **_PAIR_FEATURES},
        method=Method("matcher", "wbflow_stages.disparity:MATCHERS", given=("pair",)),
        products=Products(
            {"picture": "wbflow_stages.exports.previews:disparity_preview"},
            picture_inputs={**_FRAMES, "rectification": own("rectify")},
        ),
        summary=summaries.DisparitySummary,
    ),
    Stage(
        "calibration",
        scope="site",
        function="wbflow_stages.calibration:check_calibration",
        inputs={"poses": own("poses"), "disparities": every("disparity", optional=True)},
        optional=lambda site: site.some_given,
        reuse=Reuse(stored=False),
        summary=summaries.CalibrationCheck,
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
        reuse=Reuse(aggregate="wbflow_stages.pooled:pool_depths"),
        summary=summaries.DepthSummary,
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
        reuse=Reuse(aggregate="wbflow_stages.pooled:pool_depths"),
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
        summary=summaries.FuseSummary,
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
        summary=summaries.CoverageSummary,
    ),
    Stage(
        "changes",
        scope="site",
        function="wbflow_stages.changes:find_changes",
        inputs={"poses": own("poses"), "cloud": own("fuse"), **_SURFACE, **_REFERENCE_SURFACE},
        optional=True,
        site_keys=("zones",),
        reuse=Reuse(stored=False),
        products=Products(
            {"picture": "wbflow_stages.exports.ground:changes_preview", "view": "wbflow_stages.exports.view:changes_view"},
            files="wbflow_stages.exports.ground:changes_files",
            title="What has changed",
        ),
        summary=summaries.ChangesSummary,
    ),
)

_BY_NAME = {stage.name: stage for stage in STAGES}


def stage_named(name: str) -> Stage:
    """Return the row of a stage.  Raises KeyError."""
    return _BY_NAME[name]


def ancestors(name: str) -> set[str]:
    """Return the names of a stage and of all stages that it needs, directly or not."""
    found: set[str] = set()
    waiting = [name]
    while waiting:
        stage = stage_named(waiting.pop())
        if stage.name not in found:
            found.add(stage.name)
            waiting += [source.name for source in stage.inputs.values() if source.kind == "stage"]
            if stage.scope == "pair":
                waiting.append(DENSE_PAIRS if stage.dense else PAIRS)
            if stage.reuse.shifted:
                waiting.append(HEALTH)
    return found
