"""The pose of a camera from rays and the points they hit.

Wrong matches are found (``robust``), the rest is solved (``solvers``) and adjusted by robust least
squares (``refinement``). ``bound`` says how good any estimate can be, ``carrying`` whether the
matches carry a pose at all.
"""

from tronlab.nav.pose.bound import cramer_rao_bound
from tronlab.nav.pose.carrying import check_agreement, check_view
from tronlab.nav.pose.correspondences import MIN_POINTS, Correspondences, NoPoseError
from tronlab.nav.pose.projection import jacobian_px, residuals_px
from tronlab.nav.pose.refinement import PoseEstimate, refine_pose
from tronlab.nav.pose.robust import find_agreeing, solve_poselib, solve_ransac, solve_usac
from tronlab.nav.pose.solvers import solve_epnp, solve_sqpnp

__all__ = [
    "MIN_POINTS",
    "Correspondences",
    "NoPoseError",
    "PoseEstimate",
    "check_agreement",
    "check_view",
    "cramer_rao_bound",
    "find_agreeing",
    "jacobian_px",
    "refine_pose",
    "residuals_px",
    "solve_epnp",
    "solve_poselib",
    "solve_ransac",
    "solve_sqpnp",
    "solve_usac",
]
