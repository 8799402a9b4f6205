"""The table of stages: what each works on, what it needs, and the function that does it.

The one place of the engine that names stages, stage functions, and what is in their results.  Everything else asks a row, or asks
for the stage that plays a role.
"""

from __future__ import annotations

from .rows import (
    Entry,
    Expects,
    FromPast,
    FromReference,
    FromSite,
    FromStage,
    Held,
    Judges,
    Method,
    Need,
    Part,
    Picture,
    PointTable,
    Renamed,
    Reports,
    Rework,
    Role,
    SiteValue,
    Stage,
    Which,
    WorldReports,
)

REJECTED = "wbflow_stages.types:Rejected"
"""The type of a result that says "nothing usable here": it has `reason` and `figures`."""

_OF_A_FRAME = (
    "brightness", "contrast", "saturated", "sharpness", "combing", "blocking", "cast", "colour", "noise", "frames_used",
    "doubtful", "unchanged", "taken_first", "taken_last", "taken_in_order",
)  # fmt: skip
_OF_COVERAGE = {
    "area_m2": "area", "seen_by_one": "seen_by_one", "seen_by_two": "seen_by_two",
    "angle_deg": "median_angle_deg", "error_m": "median_error", "lost_without": "lost_without",
}  # fmt: skip
_SIDES: dict[str, Need] = {"left": FromStage("features", Which.LEFT), "right": FromStage("features", Which.RIGHT)}
_FRAMES: dict[str, Need] = {"left": FromStage("frames", Which.LEFT), "right": FromStage("frames", Which.RIGHT)}
_FRAMES_TOO: dict[str, Need] = {f"{side}_frame": need for side, need in _FRAMES.items()}
_FEATURES_TOO: dict[str, Need] = {f"{side}_features": need for side, need in _SIDES.items()}
_PLACEMENTS = FromSite(SiteValue.PLACEMENT, Which.ALL)
_VIEWS = FromStage("frames", Which.ALL, Part("view"))
_HEALTHS: dict[str, Need] = {"left": FromStage("health", Which.LEFT), "right": FromStage("health", Which.RIGHT)}

_SURFACE: dict[str, Need] = {
    "frames": FromStage("frames", Which.ALL),
    "depths": FromStage("depth", Which.ALL),
    "refined": FromStage("refine", Which.ALL, optional=True),
    "scene": FromStage("scene", optional=True),
}
_OF_REFERENCE = {"poses": "poses", "cloud": "fuse", "frames": "frames", "depths": "depth", "refined": "refine"}
_REFERENCE_SURFACE: dict[str, Need] = {
    f"reference_{name}": FromReference(stage, Which.SAME if name in {"poses", "cloud"} else Which.ALL)
    for name, stage in _OF_REFERENCE.items()
}


def _told(*figures: str) -> Reports:
    """Figures that run.json has by the names that they have in the result."""
    return Reports({name: name for name in figures})


_OF_GEOMETRY = {
    "inliers": "x1_count", "angle_deg": "angle_deg", "epipolar_px": "epipolar_px", "probability": "good_probability",
}  # fmt: skip
_STILL = Held(nudged="kept", moved="kept")
"""Of results that do not depend on where single cameras look."""

_HOLD = Rework(
    "wbflow_stages.held:hold_poses",
    {
        "pinned": FromReference("poses"),
        "healths": FromStage("health", Which.ALL),
        "views": _VIEWS,
        "geometries": FromStage("geometry", Which.ALL, optional=True),
        "survey": FromSite(SiteValue.SURVEY),
    },
)
"""The cameras of the reference stay; one that was nudged is turned, one that was moved is solved from the others."""

STAGES: tuple[Stage, ...] = (
    Stage(
        "frames",
        scope="camera",
        function="wbflow_stages.frames:clean_frame",
        needs={
            "captures": FromSite(SiteValue.CAPTURES),
            "lens": FromSite(SiteValue.LENS),
            "mask": FromSite(SiteValue.MASK, optional=True),
            "privacy": FromSite(SiteValue.PRIVACY, optional=True),
        },
        role=Role.FRAME,
        missing="failed",
        site_parameters=("resolution",),
        picture=Picture("wbflow_stages.exports.previews:frame_preview"),
        large="wbflow_stages.exports.previews:frame_large",
        reports=Reports({name: name for name in _OF_A_FRAME}, notes="notes"),
    ),
    Stage(
        "health",
        scope="camera",
        function="wbflow_stages.health:examine",
        needs={
            "frame": FromStage("frames"),
            "pinned_frame": FromReference("frames"),
            "pinned_camera": FromReference("poses", part=Part("cameras")),
            "usual": FromPast("wbflow_stages.types:Usual", ("shift_x_px", "shift_y_px", "roll_deg")),
        },
        offers={"pinned_features": FromReference("features")},
        role=Role.HEALTH,
        optional=True,
        section="health",
        judges=Judges("state", "text", "figures", "expected", "remedy", "corrected"),
        kept=False,
    ),
    Stage(
        "features",
        scope="camera",
        function="wbflow_stages.features:detect",
        needs={"frame": FromStage("frames")},
        reports=Reports({"keypoints": "xy_count"}, notes="notes", sums=("keypoints",)),
        marks="wbflow_stages.exports.previews:keypoint_marks",
        renamed={
            "keypoints": Renamed("max_keypoints"),
            "light": Renamed("preprocessing", {"plain": "none", "robust": "clahe"}),
        },
        held=Held(nudged="kept", moved="anew"),
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
        held=_STILL,
    ),
    Stage(
        "pairs",
        scope="site",
        function="wbflow.pipeline.pairs:select_pairs",
        needs={"overlap": FromStage("overlap")},
        role=Role.PAIR_GRAPH,
        section="pairs",
        lists="pairs",
        world_reports=WorldReports(camera_notes="crowded"),
        held=_STILL,
    ),
    Stage(
        "matches",
        scope="pair",
        function="wbflow_stages.matches:match",
        needs=_SIDES,
        offers={**_FRAMES_TOO, "model": FromSite(SiteValue.FILE, named="model")},
        role=Role.MATCHES,
        method=Method("matcher", "wbflow_stages.matches:MATCHERS"),
        renamed={"matcher": Renamed("matcher", {"literal": "hao2011", "dominant": "hao2011-dominance"})},
        pooled="wbflow_stages.pooled:pool_matches",
        too_little=("too-few-matches", "too-few-inliers", "clustered"),
        reports=Reports({"matches": "x1_count"}),
        held=Held(nudged="kept", moved="anew"),
    ),
    Stage(
        "geometry",
        scope="pair",
        function="wbflow_stages.geometry:estimate_geometry",
        needs={"matches": FromStage("matches"), **_SIDES},
        offers=_FRAMES_TOO,
        role=Role.GEOMETRY,
        picture=Picture("wbflow_stages.exports.previews:matches_preview", _FRAMES),
        marks="wbflow_stages.exports.previews:inlier_marks",
        reports=Reports(_OF_GEOMETRY, rejected={"inliers": "inliers"}),
        held=Held(Rework("wbflow_stages.held:turn_geometry", {"pinned": FromReference("geometry"), **_HEALTHS}), moved="anew"),
    ),
    Stage(
        "poses",
        scope="site",
        function="wbflow_stages.poses:solve_poses",
        needs={
            "views": _VIEWS,
            "placements": _PLACEMENTS,
            "geometries": FromStage("geometry", Which.ALL, empty_if_stated=True),
            "survey": FromSite(SiteValue.SURVEY),
            "frames_if_rough": FromStage("frames", Which.ALL, only_if_rough=True),
        },
        offers={"frames": FromStage("frames", Which.ALL), "features": FromStage("features", Which.ALL)},
        role=Role.WORLD,
        optional=True,
        lists="components",
        world_reports=WorldReports(
            cameras={"pose": Entry("pose_checks"), "verified": Entry("pose_checks", "verified"), "pose_from": Entry("sources")},
            pairs={"poses_px": Entry("pair_checks", "adjusted_px"), "known": Entry("pair_checks", "known")},
            camera_notes="suspects",
            lost_cameras="unsolved",
        ),
        calibration="wbflow_stages.io.cameras:calibration",
        comments="wbflow_stages.io.cameras:place_comments",
        held=Held(_HOLD, _HOLD),
    ),
    Stage(
        "scene",
        scope="site",
        function="wbflow_stages.scene:find_scene",
        needs={
            "frames": FromStage("frames", Which.ALL),
            "cameras": FromStage("poses", part=Part("cameras")),
        },
        optional=True,
        site_parameters=("bounds",),
        held=_STILL,
    ),
    Stage(
        "shared",
        scope="site",
        function="wbflow_stages.shared:find_shared",
        needs={"poses": FromStage("poses")},
        optional=True,
        unless_posed=True,
        held=_STILL,
    ),
    Stage(
        "dense_pairs",
        scope="site",
        function="wbflow.pipeline.dense:select_dense_pairs",
        needs={"shared": FromStage("shared"), "pairs": FromStage("pairs")},
        role=Role.DENSE_PAIRS,
        optional=True,
        unless_posed=True,
        section="pairs",
        lists="pairs",
        held=_STILL,
    ),
    Stage(
        "rectify",
        scope="pair",
        dense=True,
        function="wbflow_stages.rectify:rectify",
        needs={
            "geometry": FromStage("geometry", unless=("left", "right")),
            "left": FromStage("poses", Which.LEFT, Part("cameras"), optional=True),
            "right": FromStage("poses", Which.RIGHT, Part("cameras"), optional=True),
            "check": FromStage("poses", part=Part("pair_checks"), optional=True),
            **_FRAMES_TOO,
            "scene": FromStage("scene", optional=True),
        },
        offers=_FEATURES_TOO,
        role=Role.RECTIFICATION,
        method=Method("method", "wbflow_stages.rectify:METHODS", given=("pair",)),
        renamed={"method": Renamed("method", {"seed": "hao2011", "literal": "hao2011"})},
        reports=_told("angle_deg", "vertical_px", "method", "verified", "row_share", "row_chance", "row_error_px"),
        held=Held(nudged="anew", moved="anew"),
    ),
    Stage(
        "disparity",
        scope="pair",
        dense=True,
        function="wbflow_stages.disparity:match_dense",
        needs={
            **_FRAMES,
            "rectification": FromStage("rectify"),
            "reference_rectification": FromReference("rectify"),
            "reference_disparity": FromReference("disparity"),
        },
        offers={"geometry": FromStage("geometry"), **_FEATURES_TOO},
        role=Role.DISPARITY,
        method=Method("matcher", "wbflow_stages.disparity:MATCHERS", given=("pair",)),
        renamed={"speck_share": Renamed("speckle_share")},
        picture=Picture("wbflow_stages.exports.previews:disparity_preview"),
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
        pooled="wbflow_stages.pooled:pool_depths",
    ),
    Stage(
        "refine",
        scope="camera",
        function="wbflow_stages.refine:refine",
        needs={
            "frame": FromStage("frames"),
            "camera": FromStage("poses", part=Part("cameras")),
            "depth": FromStage("depth"),
            "frames": FromStage("frames", Which.NEAR),
            "cameras": FromStage("poses", Which.NEAR, Part("cameras")),
            "scene": FromStage("scene", optional=True),
            "reference_camera": FromReference("poses", part=Part("cameras")),
            "reference_depth": FromReference("refine"),
        },
        role=Role.REFINED_DEPTH,
        pooled="wbflow_stages.pooled:pool_depths",
        picture=Picture("wbflow_stages.exports.previews:depth_preview"),
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
        renamed={"strict": Renamed("min_consistent_pairs")},
        table=PointTable(
            columns="wbflow_stages.io.clouds:cloud_columns",
            restore="wbflow_stages.io.clouds:cloud_of",
            figures="wbflow_stages.io.clouds:cloud_figures",
        ),
        world_reports=WorldReports(cameras={"points": Entry("given")}),
        picture=Picture("wbflow_stages.exports.previews:cloud_preview"),
        view="wbflow_stages.exports.view:cloud_view",
    ),
    Stage(
        "coverage",
        scope="site",
        function="wbflow_stages.coverage:find_coverage",
        needs={"poses": FromStage("poses"), **_SURFACE},
        optional=True,
        picture=Picture("wbflow_stages.exports.ground:coverage_preview"),
        reports=Reports(_OF_COVERAGE, expects=Expects(("area_m2", "seen_by_two"), unit="m²", words="seen by two cameras")),
        files="wbflow_stages.exports.ground:coverage_files",
        layer="wbflow_stages.exports.ground:coverage_layer",
        title="What the cameras see of the ground",
        kept=False,
    ),
    Stage(
        "changes",
        scope="site",
        function="wbflow_stages.changes:find_changes",
        needs={"poses": FromStage("poses"), "cloud": FromStage("fuse"), **_SURFACE, **_REFERENCE_SURFACE},
        optional=True,
        site_parameters=("zones",),
        picture=Picture("wbflow_stages.exports.ground:changes_preview"),
        reports=_told("compared", "count", "changed_share", "unknown_share", "noise", "changes"),
        files="wbflow_stages.exports.ground:changes_files",
        view="wbflow_stages.exports.view:changes_view",
        title="What has changed",
        kept=False,
    ),
)

ROUGH_SECONDS = {
    "frames": (0.2, 0.1), "health": (0.1, 0.1), "features": (0.4, 0.95, 1.0), "overlap": (0.1, 0.0), "pairs": (0.2, 0.0),
    "matches": (0.5, 0.0, 21.0), "geometry": (0.5, 0.0, 1.3), "poses": (0.5, 0.0), "scene": (5.0, 0.0, 6.0),
    "shared": (0.2, 0.0), "dense_pairs": (0.2, 0.0),
    "rectify": (0.1, 0.0, 4.3), "disparity": (0.5, 2.5, 20.0), "depth": (0.1, 0.3, 3.6), "refine": (0.4, 6.0, 11.0),
    "fuse": (0.3, 1.2, 6.0), "coverage": (0.5, 0.1, 1.0), "changes": (0.5, 0.1),
}  # fmt: skip
"""Seconds: of a task on one core, roughly; for each million pixels (site-wide: of each camera); to compile its kernels, once."""

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
                waiting += [stage_with(Role.DENSE_PAIRS if stage.dense else Role.PAIR_GRAPH).name]
            if stage.held:
                waiting.append(stage_with(Role.HEALTH).name)
    return found
