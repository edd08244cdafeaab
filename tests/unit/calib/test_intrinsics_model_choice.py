import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.calib.camera.model_choice import Trial
from tronlab.calib.camera.projection import DistortionModel
from tronlab.calib.camera.state import CameraFit, CameraKind
from tronlab.geometry.camera import CameraModel

N_VIEWS = 20
N_RESIDUALS = 2000
CAMERA = CameraModel(1024, 1024, 764.0, 764.0, 511.5, 511.5)


def trial(model: DistortionModel, *, fits_better_by: float, held_out_px2: float) -> Trial:
    """Give a trial whose squares fall by so many variances of 0.01 px^2."""
    scatter = 1e-4 * np.random.default_rng(len(model)).normal(size=N_VIEWS)
    return Trial(
        kind=CameraKind(model, is_bow_free=True),
        fit=CameraFit.at(CAMERA, [RigidTransform.identity()]),
        square_sum_px2=0.01 * (N_RESIDUALS - fits_better_by),
        n_residuals=N_RESIDUALS,
        held_out_px2=held_out_px2 + scatter - scatter.mean(),
    )


RADIAL = trial("radial", fits_better_by=0, held_out_px2=0.01)


@pytest.mark.parametrize(
    ("model", "fits_better_by", "held_out_px2", "is_better"),
    [
        ("brown", 15, 0.0098, True),
        ("brown", 15, 0.01001, True),
        ("brown", 15, 0.0110, False),
        ("brown", 3, 0.0098, False),
        ("rational", 15, 0.0098, False),
        ("rational", 30, 0.0098, True),
        ("rational", 30, 0.01001, False),
    ],
)
def test_a_model_needs_a_better_fit_and_no_worse_prediction(
    model: DistortionModel, fits_better_by: float, held_out_px2: float, is_better: bool
) -> None:
    """The rational one needs a much better fit and a better prediction."""
    general = trial(model, fits_better_by=fits_better_by, held_out_px2=held_out_px2)
    assert general.beats(RADIAL) == is_better


def test_the_f_test_is_that_of_chance() -> None:
    """Three coefficients too many lower the squares by chi-square of 3 variances."""
    chance = np.random.default_rng(1).chisquare(3, size=2000)
    p_values = [
        trial("brown", fits_better_by=drop, held_out_px2=0.01).p_value(RADIAL) for drop in chance
    ]
    assert np.mean(np.array(p_values) < 0.05) == pytest.approx(0.05, abs=0.015)


def test_rounding_is_no_improvement() -> None:
    exact = Trial(RADIAL.kind, RADIAL.fit, 1e-12, N_RESIDUALS, np.full(N_VIEWS, 1e-15))
    more_exact = Trial(
        CameraKind("brown", is_bow_free=True), RADIAL.fit, 0.0, N_RESIDUALS, np.zeros(N_VIEWS)
    )
    assert not more_exact.beats(exact)
