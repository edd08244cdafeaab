"""How camera, robot and rail are mounted, nominally or as calibrated: where to drive for a pose."""

from dataclasses import dataclass

from scipy.spatial.transform import RigidTransform

from tronlab.devices.readings import RobotTarget
from tronlab.geometry.poses import FloatArray


@dataclass(frozen=True, slots=True)
class Mounting:
    """Camera on a flange, arm on a base, base on a rail, rail in front of the model.

    The frame rail is that of the base while the rail stands at 0.
    """

    trs_from_rail: RigidTransform
    rail_axis: FloatArray
    """How far the base moves for one metre of the rail's encoder, shape (3,), frame rail."""
    flange_from_cam: RigidTransform
    arm_forward_m: float
    """How far ahead of the base the flange is held, along x of base; the rail does the rest."""

    def robot_target(self, trs_from_cam: RigidTransform) -> RobotTarget:
        """Give where the robot must stand so that the camera has this pose."""
        rail_from_flange = self.trs_from_rail.inv() * trs_from_cam * self.flange_from_cam.inv()
        ahead_m = float(rail_from_flange.translation[0]) - self.arm_forward_m
        rail_m = ahead_m / float(self.rail_axis[0])
        base_from_rail = RigidTransform.from_translation(-rail_m * self.rail_axis)
        return RobotTarget(rail_m=rail_m, base_from_flange=base_from_rail * rail_from_flange)

    def trs_from_cam(self, target: RobotTarget) -> RigidTransform:
        """Give the pose of the camera while the robot stands there."""
        rail_from_base = RigidTransform.from_translation(target.rail_m * self.rail_axis)
        return self.trs_from_rail * rail_from_base * target.base_from_flange * self.flange_from_cam
