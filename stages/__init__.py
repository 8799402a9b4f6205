"""The vision of wbflow: plain functions that turn arrays into arrays.  Nothing here knows a path, a cache or the engine.

Conventions, kept everywhere:

* **Pixels**: `(x, y)`, x to the right, y down; the origin is the *centre* of the top-left pixel, so an image of width `w`
  covers x from -0.5 to w - 0.5.  Resizing by `s` maps `x` to `(x + 0.5) * s - 0.5`.
* **Images**: `(h, w, 3) uint8` in **RGB** order; grey images are `(h, w) float32`, 0 to 255.  Masks are `(h, w) bool`, True
  where a pixel may be used.
* **Points**: `x1, x2` are `(n, 2) float64` pixels in images 1 and 2 (left and right: the order of the cameras in the site
  file); `X` is `(n, 3) float64` in the world frame.
* **Cameras**: `x ~ K R (X - C)`; R turns world axes into camera axes (x right, y down, z forward); C is the centre.
  `cam2_R_cam1` turns a direction of camera 1 into one of camera 2.  Lengths are metres where the world is metric.
* **Depth** is z along the optical axis, not range.
* **Epipolar geometry**: `x2^T F x1 = 0`, F of unit Frobenius norm.
* **Disparity**: after rectification a point lies on the same row in both images and `x2 = x1 - d`.
* **Angles** are radians inside; degrees only where the name says so (`_deg`).
* A function that finds nothing usable *returns* `Rejected` with a reason and figures; bad input *raises* `ValueError`.
* The same inputs give the same bytes: every random choice has an explicit seed.
"""
