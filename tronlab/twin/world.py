"""The one world behind all simulated devices: what is true, and what light reaches the camera."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.devices.laboratory import LaboratorySpec
from tronlab.devices.readings import RobotTarget
from tronlab.geometry.poses import FloatArray, pose_along_boresight
from tronlab.render.rays import centre_rays
from tronlab.render.renderer import Lamp, Renderer
from tronlab.terrain.heightmap import HeightMap
from tronlab.twin.board import board_from_print, light_on_board, print_board
from tronlab.twin.config import WorldConfig
from tronlab.twin.faults import FaultScript
from tronlab.twin.truth import TrueLaboratory, Truth, build_laboratory, serial_number

_PARKED_HEIGHT_M = 1.2


@dataclass(frozen=True)
class WorldSetup:
    """What a simulated laboratory is made from."""

    config: WorldConfig
    laboratory: LaboratorySpec
    load_heightmap: Callable[[], HeightMap]
    """Gives the terrain model; called once, when the camera is connected."""


class Clock(Protocol):
    """What tells devices the time."""

    @property
    def now_s(self) -> float:
        """Get the time, seconds since 1970 UTC."""
        ...

    def advance(self, duration_s: float) -> None:
        """Let time pass."""
        ...


class SimulatedClock:
    """Time that passes only when a device takes some."""

    def __init__(self, start_s: float) -> None:
        self._now_s = start_s

    @property
    def now_s(self) -> float:
        """Get the simulated time, seconds since 1970 UTC."""
        return self._now_s

    def advance(self, duration_s: float) -> None:
        """Let time pass at once."""
        self._now_s += duration_s


class World:
    """State of the simulated laboratory. Devices change it and look at it; the pipeline never does.

    Wherever the camera sees the board it hides the terrain: it must be put in front of it. It casts
    no shadow on the terrain, and the terrain none on it.
    """

    def __init__(
        self,
        setup: WorldSetup,
        *,
        clock: Clock | None = None,
        make_renderer: Callable[[HeightMap], Renderer] | None = None,
    ) -> None:
        self.config = setup.config
        self.spec = setup.laboratory
        self.clock: Clock = clock or SimulatedClock(setup.config.start_time_s)
        self.faults = FaultScript(setup.config.faults)
        self.laboratory: TrueLaboratory = build_laboratory(self.spec, self.config)
        self.serial = serial_number(self.spec, self.config)
        self.is_lamp_on = False
        self.robot_at = _parked(self.spec)
        self._trs_from_flange = self._flange(self.robot_at)
        self._trs_from_board: RigidTransform | None = None
        self._load_heightmap = setup.load_heightmap
        self._make_renderer = make_renderer or _heightfield_renderer
        self._renderer: Renderer | None = None
        self._seen: tuple[Truth, NDArray[np.float32]] | None = None

    @property
    def truth(self) -> Truth:
        """Get what is true now; for tests, and for devices to measure."""
        return Truth(
            laboratory=self.laboratory,
            trs_from_flange=self._trs_from_flange,
            trs_from_board=self._trs_from_board,
            is_lamp_on=self.is_lamp_on,
        )

    def stand_robot(self, target: RobotTarget, *, actual: RobotTarget) -> None:
        """Let the robot stand at ``actual`` while its encoders say ``target``."""
        self.robot_at = target
        self._trs_from_flange = self._flange(actual)

    def place_board(self, trs_from_board: RigidTransform | None) -> None:
        """Put the board there, or take it away."""
        self._trs_from_board = trs_from_board

    def prepare_view(self) -> None:
        """Load the terrain, so that what is wrong with it shows before the first image.

        Raises:
            TerrainError: The terrain cannot be made or read.
        """
        self._ready_renderer()

    def radiance(self) -> NDArray[np.float32]:
        """Give the radiance of what the camera sees now, shape (rows, columns), W/(m2 sr).

        As long as nothing changes it is rendered once.
        """
        truth = self.truth
        if self._seen is None or not _is_same_view(self._seen[0], truth):
            self._seen = truth, self._render(truth)
        return self._seen[1]

    def _ready_renderer(self) -> Renderer:
        if self._renderer is None:
            self._renderer = self._make_renderer(self._load_heightmap())
        return self._renderer

    def _flange(self, robot: RobotTarget) -> RigidTransform:
        rail_from_base = RigidTransform.from_translation([robot.rail_m, 0.0, 0.0])
        return self.laboratory.trs_from_rail * rail_from_base * robot.base_from_flange

    def _render(self, truth: Truth) -> NDArray[np.float32]:
        camera, surface = self.laboratory.camera, self.config.surface
        if not truth.is_lamp_on:
            return np.zeros(camera.shape, np.float32)
        radiance = surface.albedo * self._render_terrain(truth.trs_from_cam)
        if truth.trs_from_board is not None:
            is_board, board = self._render_board(truth.trs_from_board, truth.trs_from_cam)
            radiance[is_board] = board
        return (radiance + surface.stray_radiance_w_per_m2_sr).astype(np.float32)

    def _render_terrain(self, trs_from_cam: RigidTransform) -> NDArray[np.float32]:
        rendering = self._ready_renderer().render(
            self.laboratory.camera,
            trs_from_cam,
            self._lamp(),
            photometry=self.config.surface.photometry,
            rays_per_pixel=self.config.surface.rays_per_pixel,
        )
        return rendering.radiance

    def _render_board(
        self, trs_from_board: RigidTransform, trs_from_cam: RigidTransform
    ) -> tuple[NDArray[np.bool_], FloatArray]:
        """Give where the board is seen, (rows, columns), and its radiance there, (n,)."""
        from tronlab.render.board import render_plane

        spec, config, camera = self.spec.board, self.config.board, self.laboratory.camera
        texture, texel_m = print_board(spec)
        whiteness, is_board = render_plane(
            texture,
            texel_m,
            camera,
            trs_from_board * board_from_print(spec),
            trs_from_cam,
            self.config.surface.rays_per_pixel,
        )
        albedo = config.black_albedo + (config.white_albedo - config.black_albedo) * whiteness
        rays = centre_rays(camera)[is_board]
        light = light_on_board(rays, trs_from_board, trs_from_cam, self._lamp())
        return is_board, albedo[is_board] * light

    def _lamp(self) -> Lamp:
        return Lamp(
            p_trs_m=self.laboratory.p_light_trs_m,
            intensity=self.config.lamp.intensity_w_per_sr / np.pi,
        )


def _parked(spec: LaboratorySpec) -> RobotTarget:
    """Give where the robot stands at first: low end of the rail, camera towards the model."""
    trs_from_cam = pose_along_boresight(np.zeros(3), boresight=[0, 0, -1], right=[0, 1, 0])
    turned = spec.mounting.robot_target(trs_from_cam).base_from_flange.rotation
    place = [spec.mounting.arm_forward_m, 0.0, _PARKED_HEIGHT_M]
    return RobotTarget(
        rail_m=spec.mounting.rail_range_m[0],
        base_from_flange=RigidTransform.from_components(place, turned),
    )


def _heightfield_renderer(heightmap: HeightMap) -> Renderer:
    from tronlab.render.heightfield import HeightfieldRenderer

    return HeightfieldRenderer(heightmap)


def _is_same_view(a: Truth, b: Truth) -> bool:
    return (
        a.trs_from_flange is b.trs_from_flange
        and a.trs_from_board is b.trs_from_board
        and a.is_lamp_on == b.is_lamp_on
    )
