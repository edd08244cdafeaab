"""The prior a core is offered: the truth with an error, or its own last answer.

A covariance is of (rotation vector, translation) in trs, as ``geometry.uncertainty`` has it: the
true pose is the prior, perturbed by a draw from it.
"""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import RigidTransform

from tronlab.geometry.poses import FloatArray
from tronlab.geometry.uncertainty import perturb
from tronlab.nav.core import NavigationResult, PosePrior
from tronlab.yaml_models import Model


class PriorSettings(Model):
    """Which prior a core is offered with every image."""

    source: Literal["truth", "previous"]
    """``truth``: the true pose with a random error. ``previous``: the core's last answer, less
    certain by the sigmas below with every image since; none before the first answer."""
    position_sigma_m: Annotated[float, Field(gt=0)]
    """Of each axis."""
    rotation_sigma_deg: Annotated[float, Field(gt=0)]
    """About each axis."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Of the random errors."""

    def covariance(self) -> FloatArray:
        """Give the covariance the sigmas stand for, shape (6, 6)."""
        sigmas = np.repeat([np.radians(self.rotation_sigma_deg), self.position_sigma_m], 3)
        return np.diag(sigmas**2)


def drawn_prior(
    settings: PriorSettings, shot_id: int, trs_from_cam_true: RigidTransform
) -> PosePrior:
    """Give the truth with a random error, the same for a shot in whatever order they come."""
    covariance = settings.covariance()
    error = np.random.default_rng([settings.seed, shot_id]).normal(size=6)
    error *= np.sqrt(np.diag(covariance))
    return PosePrior(_unperturbed(trs_from_cam_true, error), covariance)


def prior_after(
    settings: PriorSettings, prior: PosePrior | None, result: NavigationResult
) -> PosePrior | None:
    """Give what is known at the next image.

    Args:
        settings: How much less certain it is by then.
        prior: What was known at this image.
        result: What the core answered to it.
    """
    if result.status == "ok" and result.trs_from_cam is not None:
        certain = np.zeros((6, 6)) if result.covariance is None else result.covariance
        return PosePrior(result.trs_from_cam, certain + settings.covariance())
    if prior is None:
        return None
    return PosePrior(prior.trs_from_cam, prior.covariance + settings.covariance())


def _unperturbed(pose: RigidTransform, difference: FloatArray) -> RigidTransform:
    """Give the pose that ``perturb`` with this difference leads to ``pose`` from."""
    return perturb(pose, -difference)
