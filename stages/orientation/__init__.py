"""Orientation: cameras in the world, by what the site file states of them and what their pictures show.

Without stated poses `solve` puts models (see `sfm`) into the `world`, with lenses as sure as `lens_sigma` finds them, from
matches in `triplet_consistency`.  Stated poses are compared with the pictures (`pose_check`, `calibration_check`,
`survey_check`), found moved (`moved_cameras`), or adjusted within their standard deviations (`pose_prior_adjustment`,
`ground_adjustment`).
"""
