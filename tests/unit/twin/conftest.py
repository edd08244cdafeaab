"""A small laboratory: that of campaigns/rigs/twin.yaml with a coarse sensor and a flat terrain."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from tronlab.campaign.rig import load_rig
from tronlab.devices.laboratory import LaboratorySpec
from tronlab.devices.registry import KINDS, DeviceContext, Devices, make_device
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_along_boresight
from tronlab.render.renderer import Lamp, Rendering
from tronlab.terrain.heightmap import HeightMap
from tronlab.twin.config import WorldConfig
from tronlab.twin.devices import WORLD_KEY
from tronlab.twin.world import World, WorldSetup

TWIN_YAML = Path(__file__).parents[3] / "campaigns" / "rigs" / "twin.yaml"

COARSENESS = 16
"""Pixels of the small sensor are this much larger, and fewer."""


@dataclass
class UniformRenderer:
    """A terrain of one radiance everywhere, that counts how often it is rendered."""

    radiance: float = 0.02
    poses: list[RigidTransform] = field(default_factory=list)

    def render(
        self, camera: CameraModel, trs_from_cam: RigidTransform, lamp: Lamp, *_: Any
    ) -> Rendering:
        self.poses.append(trs_from_cam)
        return Rendering(
            radiance=np.full(camera.shape, self.radiance, np.float32),
            depth_m=np.ones(camera.shape, np.float32),
            points_trs_m=np.zeros((*camera.shape, 3), np.float32),
            is_lit=np.ones(camera.shape, np.bool_),
        )


@dataclass
class Bench:
    """Devices, the world behind them, and what renders it."""

    devices: Devices
    world: World
    renderer: UniformRenderer


def coarse(spec: LaboratorySpec, factor: int) -> LaboratorySpec:
    camera = spec.camera
    small = {
        name: getattr(camera, name) // factor
        for name in ("sensor_width_px", "sensor_height_px", "left_px", "width_px", "height_px")
    }
    pitch_m = camera.pixel_pitch_m * factor
    camera = camera.model_copy(update={**small, "pixel_pitch_m": pitch_m})
    return spec.model_copy(update={"camera": camera})


def flat_heightmap() -> HeightMap:
    return HeightMap(
        height_m=np.zeros((23, 43), np.float32), spacing_m=0.1, origin_trs_m=np.zeros(3)
    )


@pytest.fixture(scope="session")
def twin_rig():
    return load_rig(TWIN_YAML)


@pytest.fixture(scope="session")
def spec(twin_rig) -> LaboratorySpec:
    return coarse(twin_rig.config.laboratory, COARSENESS)


@pytest.fixture(scope="session")
def config(twin_rig) -> WorldConfig:
    lens = twin_rig.config.world.lens.model_copy(update={"principal_point_sigma_px": 0.5})
    return twin_rig.config.world.model_copy(update={"lens": lens})


@pytest.fixture
def setup(spec: LaboratorySpec, config: WorldConfig) -> WorldSetup:
    return WorldSetup(config, spec, flat_heightmap)


@pytest.fixture
def bench(twin_rig, config: WorldConfig) -> Callable[..., Bench]:
    """Make a bench; keyword arguments replace sections of the world."""

    def make(
        seed: int = 5, *, connect: bool = True, coarseness: int = COARSENESS, **sections: Any
    ) -> Bench:
        values = {**config.model_dump(), **sections}
        setup = WorldSetup(
            config=WorldConfig.model_validate(values),
            laboratory=coarse(twin_rig.config.laboratory, coarseness),
            load_heightmap=flat_heightmap,
        )
        renderer = UniformRenderer()
        world = World(setup, make_renderer=lambda _: renderer)
        world.state.change(lamp_level=1.0)
        shared: dict[str, object] = {WORLD_KEY: world}
        made = {
            kind: make_device(
                f"twin.{kind}",
                kind,
                DeviceContext(name=kind, options={}, seed=seed, world=setup, shared=shared),
            )
            for kind in KINDS
        }
        devices = Devices(**made)  # type: ignore[arg-type]
        if connect:
            for device in devices.all():
                device.connect()
        return Bench(devices, world, renderer)

    return make


@pytest.fixture(scope="session")
def look_at() -> Callable[..., RigidTransform]:
    """Give the pose of a camera before the model; tilts turn it about its own x and y."""

    def pose(
        x_m: float = 1.08,
        y_m: float = 2.08,
        z_m: float = 2.0,
        *,
        tilt_x_deg: float = 0.0,
        tilt_y_deg: float = 0.0,
    ) -> RigidTransform:
        boresight = [np.tan(np.radians(tilt_x_deg)), np.tan(np.radians(tilt_y_deg)), -1.0]
        return pose_along_boresight([x_m, y_m, z_m], boresight=boresight, right=[0, 1, 0])

    return pose
