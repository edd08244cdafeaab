"""Images to measure the computational load with: the study's laboratory in any number of pixels."""

import json
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.campaign.job import Job
from tronlab.errors import PlanError
from tronlab.render.mask import model_mask

if TYPE_CHECKING:
    from tronlab.terrain.heightmap import HeightMap
    from tronlab.twin.config import WorldConfig

OnPart = Callable[[int, int], None]
"""Told (parts done, parts in all)."""

_SEED: Final = 5
_LEAST_USABLE: Final = 0.2
_SHIFT: Final = 0.02
"""One sigma of how far beside the campaign's poses images are taken, as a part of the height."""
_TURN_RAD: Final = float(np.radians(2.0))
"""Likewise of each axis."""
_BRIGHT: Final = 0.86
"""Part of a full well that the brightest per cent of an image fills."""
_BRIGHT_PERCENTILE: Final = 99.0
_LOOK_PX: Final = 128
"""Pixels in a row that suffice to see how much of an image is terrain."""


def frames_file(folder: Path, image_px: int) -> Path:
    """Give the name of the file of images of that many pixels in a row."""
    return folder / f"frames-{image_px}.npz"


def make_frames(
    job: Job, folder: Path, *, image_px: Iterable[int], n_images: int, on_part: OnPart
) -> None:
    """Take images near the campaign's poses, as its simulated laboratory would.

    Terrain, surface, lamp, lens and sensor are the true ones; only the number of pixels changes.
    Blur, in pixels, and noise of a pixel stay. A file has, for image number ``i``, the arrays
    ``image_i``, ``mask_i``, ``pose_i`` (``trs_from_cam``, shape (4, 4)) and ``range_m_i``, and once
    the calibrated ``camera`` as JSON.

    Args:
        job: The campaign.
        folder: Where to.
        image_px: Pixels in a row.
        n_images: Of each size.
        on_part: Told of each size that is done.

    Raises:
        PlanError: The rig has no simulated laboratory, or no pose sees enough of the terrain.
    """
    from tronlab.render.registry import open_renderer
    from tronlab.twin.world import World

    setup = job.rig.world_setup()
    if setup is None:
        raise PlanError(
            f"{job.rig.path}: has no section 'world'; computational load is measured with images of"
            " a simulated laboratory, name a campaign of one"
        )
    world, surface = World(setup), setup.config.surface
    heightmap = setup.load_heightmap()
    renderer = open_renderer(surface.renderer, heightmap, every_n=surface.every_n)
    poses = _poses_of_images(job, heightmap, n_images)
    sizes = tuple(image_px)
    for n_done, side_px in enumerate(sizes):
        on_part(n_done, len(sizes))
        camera = world.laboratory.camera.scaled(side_px)
        calibrated = job.calibration.camera.scaled(side_px)
        arrays: dict[str, Any] = {"camera": json.dumps(calibrated.to_dict())}
        for i, pose in enumerate(poses):
            seen = renderer.render(camera, pose, world.lamp, surface)
            radiance = surface.albedo * seen.radiance + surface.stray_radiance_w_per_m2_sr
            rng = np.random.default_rng([_SEED, side_px, i])
            arrays[f"image_{i}"] = _photograph(radiance, setup.config, rng)
            arrays[f"mask_{i}"] = model_mask(heightmap, calibrated, pose)
            arrays[f"pose_{i}"] = pose.as_matrix()
            arrays[f"range_m_{i}"] = np.nanmedian(seen.depth_m)
        np.savez(frames_file(folder, side_px), **arrays)
    on_part(len(sizes), len(sizes))


def _photograph(
    radiance: NDArray[np.float32], config: "WorldConfig", rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Take an image of 8 bit, exposed so that the brightest per cent nearly fills the pixels."""
    from tronlab.twin.sensor import blur, digitise, expose

    sensor = config.sensor
    bright = float(np.percentile(radiance, _BRIGHT_PERCENTILE))
    exposure_s = _BRIGHT * sensor.full_well_e / (sensor.electrons_per_radiance * bright)
    blurred = blur(radiance, sigma_px=config.lens.psf_sigma_px)
    electrons = expose(blurred, sensor, exposure_s=exposure_s, rng=rng)
    return digitise(electrons, sensor, gain_db=0.0, pixel_format="Mono8").astype(np.uint8)


def _poses_of_images(job: Job, heightmap: "HeightMap", n: int) -> list[RigidTransform]:
    """Choose poses beside those of the campaign, from its first to its last that sees enough.

    Raises:
        PlanError: None does.
    """
    camera = job.calibration.camera.scaled(_LOOK_PX)
    nominal = [shot.trs_from_cam_nominal for shot in job.plan.shots]
    usable = [p for p in nominal if model_mask(heightmap, camera, p).mean() >= _LEAST_USABLE]
    if not usable:
        raise PlanError(
            f"{job.campaign.path}: no pose has terrain in {100 * _LEAST_USABLE:.0f} % of its image;"
            " the computational load cannot be measured there"
        )
    rng = np.random.default_rng(_SEED)
    chosen = np.rint(np.linspace(0, len(usable) - 1, n)).astype(int)
    return [_beside(usable[i], heightmap.mean_height_trs_m, rng) for i in chosen]


def _beside(pose: RigidTransform, ground_m: float, rng: np.random.Generator) -> RigidTransform:
    height_m = float(pose.translation[2]) - ground_m
    shift_m = _SHIFT * height_m * rng.standard_normal(3)
    turn = Rotation.from_rotvec(_TURN_RAD * rng.standard_normal(3))
    return RigidTransform.from_components(pose.translation + shift_m, pose.rotation * turn)
