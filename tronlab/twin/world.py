"""The one world behind all simulated devices: what is true, and what light reaches the camera."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.devices.clock import Clock, SimulatedClock
from tronlab.devices.laboratory import CameraSpec, LaboratorySpec, Vector
from tronlab.devices.readings import RobotTarget
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import FloatArray, pose_along_boresight, pose_from_xyz_quat
from tronlab.render.renderer import Lamp, Renderer, lamp_as_designed
from tronlab.terrain.heightmap import HeightMap
from tronlab.twin.board import board_from_print, bow_of_print, light_on_board, print_board
from tronlab.twin.config import WorldConfig
from tronlab.twin.faults import FaultScript
from tronlab.twin.state import LocalState, RobotState, StateStore, WorldState, numbers_of
from tronlab.twin.truth import (
    TrueLaboratory,
    Truth,
    build_laboratory,
    read_out,
    serial_number,
)

_PARKED_HEIGHT_M = 1.2


@dataclass(frozen=True)
class WorldSetup:
    """What a simulated laboratory is made from."""

    config: WorldConfig
    laboratory: LaboratorySpec
    load_heightmap: Callable[[], HeightMap]
    """Gives the terrain model; called once, when the camera is connected."""


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
        state: StateStore | None = None,
    ) -> None:
        self.config = setup.config
        self.spec = setup.laboratory
        self.clock: Clock = clock or SimulatedClock(setup.config.start_time_s)
        self.faults = FaultScript(setup.config.faults, laboratory=self)
        self.laboratory: TrueLaboratory = build_laboratory(self.spec, self.config)
        self.serial = serial_number(self.spec, self.config)
        self.state: StateStore = state or LocalState(initial_state(setup))
        self._load_heightmap = setup.load_heightmap
        self._make_renderer = make_renderer or self._open_renderer
        self._renderer: Renderer | None = None
        self._seeing = threading.Lock()
        self._seen: tuple[object, NDArray[np.float32]] | None = None

    @property
    def truth(self) -> Truth:
        """Get what is true now; for tests, and for devices to measure."""
        return self._truth(self.state.read())

    @property
    def lamp(self) -> Lamp:
        """Get the lamp as it burns at full light."""
        lamp = lamp_as_designed(
            self.spec.lamp,
            self.laboratory.p_light_trs_m,
            intensity=self.config.lamp.intensity_w_per_sr / np.pi,
        )
        radius_m = self.config.lamp.radius_m
        return lamp if radius_m is None else replace(lamp, radius_m=radius_m)

    @property
    def robot_at(self) -> RobotTarget:
        """Get where the robot's encoders say it stands."""
        return self.state.read().robot_encoders.target

    def trs_from_cam_at(self, target: RobotTarget) -> RigidTransform:
        """Give where the camera is when the robot stands exactly there."""
        return self._flange(target) * self.laboratory.flange_from_cam

    def stand_robot(self, target: RobotTarget, *, actual: RobotTarget) -> None:
        """Let the robot stand at ``actual`` while its encoders say ``target``."""
        self.state.change(robot_encoders=RobotState.at(target), robot_actual=RobotState.at(actual))

    def move_tracker(self, shift_m: Vector) -> None:
        """Push the tracker, as someone might who trips over its stand; shift in trs."""
        x, y, z = np.array(self.state.read().tracker_shift_m) + np.array(shift_m)
        self.state.change(tracker_shift_m=(float(x), float(y), float(z)))

    def open_door(self, *, is_open: bool) -> None:
        """Open the door, or close it."""
        self.state.change(is_door_closed=not is_open)

    def dim_lamp(self, level: float) -> None:
        """Let the lamp give this part of its full light."""
        self.state.change(lamp_level=level)

    def place_board(self, trs_from_board: RigidTransform | None) -> None:
        """Put the board there, or take it away."""
        board = None if trs_from_board is None else numbers_of(trs_from_board)
        self.state.change(trs_from_board=board)

    def prepare_view(self) -> None:
        """Load the terrain, so that what is wrong with it shows before the first image.

        Raises:
            TerrainError: The terrain cannot be made or read.
        """
        self._ready_renderer()

    def rehearse_view(self) -> None:
        """Render once as if the lamp burned: the first time takes longer than all others.

        Raises:
            TerrainError: The terrain cannot be made or read.
        """
        self._render_terrain(self.laboratory.camera, self.truth.trs_from_cam)

    def radiance(self, region: CameraSpec | None = None) -> NDArray[np.float32]:
        """Give the radiance of what the camera sees now, shape (rows, columns), W/(m2 sr).

        As long as nothing changes it is rendered once, however many threads ask.

        Args:
            region: The camera with the region of the sensor to read out; by default the rig's.
        """
        state, region = self.state.read(), region or self.spec.camera
        seen = state.view, region
        with self._seeing:
            if self._seen is None or self._seen[0] != seen:
                camera = read_out(self.laboratory.sensor, region)
                self._seen = seen, self._render(camera, self._truth(state), state.lamp_level)
            return self._seen[1]

    def _truth(self, state: WorldState) -> Truth:
        board = state.trs_from_board
        return Truth(
            laboratory=self.laboratory,
            trs_from_flange=self._flange(state.robot_actual.target),
            trs_from_board=None if board is None else pose_from_xyz_quat(board),
            is_lamp_on=state.lamp_level > 0.0,
            trk_from_trs=self._trk_from_trs(state),
        )

    def _trk_from_trs(self, state: WorldState) -> RigidTransform:
        moved_back = RigidTransform.from_translation(-np.array(state.tracker_shift_m))
        return self.laboratory.trk_from_trs * moved_back

    def _ready_renderer(self) -> Renderer:
        if self._renderer is None:
            self._renderer = self._make_renderer(self._load_heightmap())
        return self._renderer

    def _open_renderer(self, heightmap: HeightMap) -> Renderer:
        from tronlab.render.registry import open_renderer

        surface = self.config.surface
        return open_renderer(surface.renderer, heightmap, every_n=surface.every_n)

    def _flange(self, robot: RobotTarget) -> RigidTransform:
        rail_from_base = RigidTransform.from_translation(robot.rail_m * self.laboratory.rail_axis)
        return self.laboratory.trs_from_rail * rail_from_base * robot.base_from_flange

    def _render(self, camera: CameraModel, truth: Truth, lamp_level: float) -> NDArray[np.float32]:
        surface = self.config.surface
        if not truth.is_lamp_on:
            return np.zeros(camera.shape, np.float32)
        radiance = surface.albedo * self._render_terrain(camera, truth.trs_from_cam)
        if truth.trs_from_board is not None:
            is_board, board = self._render_board(camera, truth.trs_from_board, truth.trs_from_cam)
            radiance[is_board] = board
        return (lamp_level * (radiance + surface.stray_radiance_w_per_m2_sr)).astype(np.float32)

    def _render_terrain(
        self, camera: CameraModel, trs_from_cam: RigidTransform
    ) -> NDArray[np.float32]:
        renderer = self._ready_renderer()
        return renderer.render(camera, trs_from_cam, self.lamp, self.config.surface).radiance

    def _render_board(
        self, camera: CameraModel, trs_from_board: RigidTransform, trs_from_cam: RigidTransform
    ) -> tuple[NDArray[np.bool_], FloatArray]:
        """Give where the board is seen, (rows, columns), and its radiance there, (n,)."""
        from tronlab.render.board import render_board
        from tronlab.render.rays import centre_rays

        spec, config = self.spec.board, self.config.board
        texture, texel_m = print_board(spec)
        whiteness, is_board = render_board(
            texture,
            texel_m,
            camera,
            trs_from_board * board_from_print(spec),
            trs_from_cam,
            self.config.surface.rays_per_pixel,
            bow=bow_of_print(spec, self.laboratory.board_bow_m),
        )
        albedo = config.black_albedo + (config.white_albedo - config.black_albedo) * whiteness
        rays = centre_rays(camera)[is_board]
        light = light_on_board(rays, trs_from_board, trs_from_cam, self.lamp)
        return is_board, albedo[is_board] * light


def initial_state(setup: WorldSetup) -> WorldState:
    """Give the state of a laboratory nobody has used yet: robot parked, lamp dark, no board."""
    parked, room = RobotState.at(_parked(setup.laboratory)), setup.config.room
    return WorldState(
        robot_encoders=parked,
        robot_actual=parked,
        trs_from_board=None,
        lamp_level=0.0,
        is_door_closed=room.is_door_closed,
        air_temperature_k=room.air_temperature_k,
        air_pressure_pa=room.air_pressure_pa,
        relative_humidity=room.relative_humidity,
    )


def _parked(spec: LaboratorySpec) -> RobotTarget:
    """Give where the robot stands at first: low end of the rail, camera towards the model."""
    trs_from_cam = pose_along_boresight(np.zeros(3), boresight=[0, 0, -1], right=[0, 1, 0])
    turned = spec.mounting.nominal.robot_target(trs_from_cam).base_from_flange.rotation
    place = [spec.mounting.arm_forward_m, 0.0, _PARKED_HEIGHT_M]
    return RobotTarget(
        rail_m=spec.mounting.rail_range_m[0],
        base_from_flange=RigidTransform.from_components(place, turned),
    )
