"""Defaults of parameters that stand in more than one signature, or in the site file and in a stage."""

RESOLUTION = 1600
"""Long side in pixels at which the stages work; finer is slower, and seldom better."""

PAIR_DEGREE = 6
"""Pairs of each camera; more pairs cost time, fewer leave less evidence."""
PAIR_MIN_ANGLE_DEG = 4.0
"""Smallest angle between two views of a pair; below it, depth is poorly determined."""
PAIR_MAX_ANGLE_DEG = 60.0
"""Largest angle between two views of a pair; beyond it, few points match."""

NUDGED_PX = 1.5
"""Shift of a camera's picture, pixels, from which the camera counts as shifted."""
MOVED_DEG = 0.4
"""Rotation of a camera, degrees, from which the camera counts as moved."""
FLAT_SHARE = 0.9
"""Share of a picture without structure, from which it counts as obscured."""
DARK_LEVELS = 6.0
"""Contrast in grey levels, below which a picture counts as dark."""

NOISE_PX = 0.35
"""Standard deviation of matched points, pixels; a larger one makes all standard deviations of depth larger."""
VIEW_ANGLE_DEG = 4.0
"""Smallest angle between the rays of two views that measure a point together."""
RAY_ANGLE_DEG = 0.7
"""Smallest angle between the rays of a pair's matches; below it, the pair has no usable baseline."""
ROTATION_ERROR_DEG = 4.0
"""Largest rotation by which a pair may contradict the cameras, degrees."""
EPIPOLAR_ERROR_PX = 2.0
"""Largest median distance of a pair's matches to the epipolar lines of the cameras, pixels."""
NEIGHBOUR_RATIO = 0.8
"""Largest ratio of the distances to the nearest and the second nearest descriptor (Lowe 2004)."""
SEED = 0
"""Seed of random choices."""
MAX_KEYPOINTS = 6000
"""Most keypoints that a detector keeps in the plain view."""
TILTED_KEYPOINTS = 3000
"""Most keypoints kept in the view compressed by 2 in x."""
GRID_COLUMNS = 6
"""Square cells across the image, over which keypoints are spread."""
CROWDING = 2.0
"""A cell yields at most this many times its even share of keypoints while other cells still have some."""
MIN_SCORE = 0.0
"""Least score of what a network finds, 0 to 1: everything counts."""
