"""Orientation: cameras in the world, from what the site file states about them and what their pictures show.

Without stated poses, `solve` builds models (see `sfm`) and aligns them with the `world`; `lens_sigma` estimates how well their
lenses are known, and `triplet_consistency` whether their matches are consistent.  Stated poses are compared with the pictures
(`pose_check`, `calibration_check`, `survey_check`), found to have moved (`moved_cameras`), or adjusted within usual errors
(`usual_errors`) or their standard deviations (`pose_prior_adjustment`, `ground_adjustment`).
"""
