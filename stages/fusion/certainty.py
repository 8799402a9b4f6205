"""How sure a depth is: what its own noise model expects, put right by how much other views' depths differ from it.

Errors of matching follow texture, shading and the slant of a surface, which no model of pixel noise knows; views that disagree
show them.  Two views of `n + 1` share one of the n pairs that each one's depth rests on, so that their errors correlate by 1 / n
and their difference r has the variance

    E r^2 = 2 sigma^2 (1 - 1 / n):    sigma^2 = sum r^2 / (2 (n - 1)),

the usual estimate with n - 1 degrees of freedom.  Before it stands what the model says, as an inverse gamma prior that weighs as
much as `_PRIOR_VIEWS` views (Gelman et al., Bayesian Data Analysis, 3.3); where a view is compared with none or one, which says
nothing of its own errors since they are the other's, too, the prior alone is left.
"""

from __future__ import annotations

import numpy as np

from ..types import DepthMap, Float64s, Int64s
from .visibility import CrossCheck

_PRIOR_VIEWS = 0.1
_PRIOR_SHARE = 0.55
"""Of the model's variance: errors of depths that no second view judges are smaller than it fears (fitted on the demo yard)."""


def depth_variance(depth: DepthMap, check: CrossCheck, y: Int64s, x: Int64s) -> Float64s:
    """(n,) squared standard deviation of depths along their rays, world lengths.

    Parameters
    ----------
    depth, check
        Of a view, and what the others say of it.
    y, x
        (n,) rows and columns of pixels that have a depth.
    """
    z, expected = depth.depth[y, x].astype(np.float64), depth.sigma[y, x].astype(np.float64) ** 2
    others = check.compared[y, x].astype(np.float64)
    freedom = np.maximum(others - 1, 0)
    seen = np.where(others > 1, 0.5 * check.scatter[y, x].astype(np.float64) * z**2, 0.0)
    return np.asarray((_PRIOR_VIEWS * _PRIOR_SHARE * expected + seen) / (_PRIOR_VIEWS + freedom), dtype=np.float64)
