"""Orientation: cameras in the world, from what the site file states about them and what their images show.

Without stated poses, `solve` builds models (see `sfm`) and aligns them with the `world`; `lens_sigma` estimates how well their
lenses are known, and `triplet_consistency` whether their matches are consistent.  Stated poses are compared with the images
(`pose_check`, `calibration_check`, `survey_check`), replaced if a camera has moved (`moved_cameras`), and adjusted within
typical errors (`typical_errors`) or their standard deviations (`pose_prior_adjustment`, `ground_adjustment`).
"""
