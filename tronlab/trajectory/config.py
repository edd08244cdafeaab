"""The ``trajectory`` section of a campaign file."""

from typing import Annotated, Literal, TypeAlias

from pydantic import Field, model_validator

from tronlab.errors import FrameError
from tronlab.geometry.poses import pose_along_boresight
from tronlab.yaml_models import ExistingFile, Model

Vector: TypeAlias = tuple[float, float, float]


class StraightLine(Model):
    """Equally spaced camera positions on a line, all with one orientation."""

    kind: Literal["straight_line"]
    start_trs_m: Vector
    """First position of the camera, frame trs."""
    end_trs_m: Vector
    """Last position of the camera, frame trs."""
    n_points: Annotated[int, Field(ge=1, le=1_000_000)]
    """Number of poses, both ends included."""
    boresight_trs: Vector = (0.0, 0.0, -1.0)
    """Direction the camera looks in, frame trs; any length."""
    right_trs: Vector = (0.0, 1.0, 0.0)
    """Direction that is to the right in the image, frame trs; any length."""

    @model_validator(mode="after")
    def _is_a_line(self) -> "StraightLine":
        if self.n_points > 1 and self.start_trs_m == self.end_trs_m:
            raise ValueError("start_trs_m and end_trs_m are the same point; expected a line")
        try:
            pose_along_boresight(
                self.start_trs_m, boresight=self.boresight_trs, right=self.right_trs
            )
        except FrameError as error:
            raise ValueError(f"boresight_trs, right_trs: {error}") from error
        return self


class PoseFile(Model):
    """Camera poses from a CSV file."""

    kind: Literal["file"]
    path: ExistingFile
    """CSV with the header ``x,y,z,qx,qy,qz,qw``: trs_from_cam a line, metres and unit quaternion,
    scalar last. Relative to the campaign file."""


TrajectoryConfig: TypeAlias = Annotated[StraightLine | PoseFile, Field(discriminator="kind")]
