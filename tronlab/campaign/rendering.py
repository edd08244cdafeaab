"""Images of a campaign without taking it: rendered from its nominal poses into a folder."""

import csv
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from tronlab.campaign.job import Job, check_can_be_made
from tronlab.campaign.reference import GreyScale
from tronlab.errors import ConfigError
from tronlab.geometry.camera import CameraModel
from tronlab.render.pose_file import write_poses
from tronlab.render.renderer import Lamp, Renderer, Rendering
from tronlab.render.settings import RenderSettings

VIEWS_NAME = "views.csv"
POSES_NAME = "poses.txt"
_COLUMNS = (
    "view_id", "image", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw",
    "terrain_fraction", "lit_fraction", "mean_radiance",
)  # fmt: skip
_SAMPLED_PX = 8
"""Every so many pixels count for the grey scale: enough for a percentile."""


@dataclass(frozen=True)
class Scene:
    """What is rendered: by whom, with which camera, from where, in which light."""

    name: str
    renderer: Renderer
    renderer_name: str
    camera: CameraModel
    poses: Mapping[int, RigidTransform]
    """``trs_from_cam`` of each view, by its number."""
    lamp: Lamp
    settings: RenderSettings
    albedo: float = 1.0
    stray_radiance: float = 0.0
    """Added everywhere, W/(m2 sr)."""


@dataclass(frozen=True, slots=True)
class View:
    """One rendered image and what is seen in it."""

    view_id: int
    trs_from_cam: RigidTransform
    image_path: Path
    """8-bit PNG."""
    terrain_fraction: float
    """Part of the pixels that show terrain."""
    lit_fraction: float
    """Part of those that the lamp lights; NaN without terrain."""
    mean_radiance: float


def check_new_folder(out: Path) -> Path:
    """Give the folder if it is new or empty; it is not made yet.

    Raises:
        ConfigError: It is a file, is in use, or cannot be made.
    """
    check_can_be_made(out)
    if out.exists() and any(out.iterdir()):
        raise ConfigError(
            f"--out {out}: exists and is not empty, nothing is overwritten;"
            " name another folder with --out"
        )
    return out


def poses_of(job: Job, shot_ids: Sequence[int] | None) -> dict[int, RigidTransform]:
    """Give the nominal poses of shots, by number.

    Args:
        job: The campaign.
        shot_ids: Which; None: all.

    Raises:
        ConfigError: The campaign has no shot of such a number.
    """
    poses = {shot.shot_id: shot.trs_from_cam_nominal for shot in job.plan.shots}
    if shot_ids is None:
        return poses
    missing = [str(shot_id) for shot_id in shot_ids if shot_id not in poses]
    if missing:
        raise ConfigError(
            f"--shots: the campaign has no shot {', '.join(missing)}; it has {min(poses)} to"
            f" {max(poses)}"
        )
    return {shot_id: poses[shot_id] for shot_id in shot_ids}


def database_poses(job: Job) -> dict[int, RigidTransform]:
    """Give the poses of the reference views, by the numbers they have in a dataset."""
    return dict(enumerate(job.reference_poses, start=1))


def render_scene(
    scene: Scene, folder: Path, *, on_view: Callable[[int, int], None]
) -> tuple[View, ...]:
    """Render all views of a scene.

    Radiance and depth are written as each view is ready; the images follow at the end, for one grey
    scale serves them all. ``poses.txt`` has the poses as Blender takes them, ``views.csv`` a row a
    view.

    Args:
        scene: What to render.
        folder: Where to; it is made with the first view.
        on_view: Told (views done, views in all) after each.

    Raises:
        RenderError: The renderer cannot do what is asked.
        PlanError: No view shows any lit terrain.
        ConfigError: A file cannot be written.
    """
    poses = list(scene.poses.values())
    views: list[View] = []
    samples: list[NDArray[np.float32]] = []
    renderings = scene.renderer.render_batch(scene.camera, poses, scene.lamp, scene.settings)
    for (view_id, pose), rendering in zip(scene.poses.items(), renderings, strict=True):
        radiance = scene.albedo * rendering.radiance + np.float32(scene.stray_radiance)
        _write_tiff(folder / "radiance" / f"{view_id:04d}.tif", radiance)
        _write_tiff(folder / "depth" / f"{view_id:04d}.tif", rendering.depth_m)
        samples.append(radiance[::_SAMPLED_PX, ::_SAMPLED_PX])
        image_path = folder / "images" / f"{view_id:04d}.png"
        views.append(_view(view_id, pose, image_path, rendering, radiance))
        on_view(len(views), len(poses))
    _write_images(views, folder, GreyScale.of(samples))
    with _writing(folder):
        write_poses(folder / POSES_NAME, poses)
        _write_table(views, folder / VIEWS_NAME)
    return tuple(views)


def _view(
    view_id: int,
    trs_from_cam: RigidTransform,
    image_path: Path,
    rendering: Rendering,
    radiance: NDArray[np.float32],
) -> View:
    is_terrain = np.isfinite(rendering.depth_m)
    return View(
        view_id=view_id,
        trs_from_cam=trs_from_cam,
        image_path=image_path,
        terrain_fraction=float(is_terrain.mean()),
        lit_fraction=float(rendering.is_lit[is_terrain].mean()) if is_terrain.any() else np.nan,
        mean_radiance=float(radiance.mean()),
    )


def _write_images(views: Sequence[View], folder: Path, scale: GreyScale) -> None:
    for view in views:
        radiance = _read_tiff(folder / "radiance" / f"{view.view_id:04d}.tif")
        _write(view.image_path, scale.grey(radiance))


def _write_table(views: Sequence[View], path: Path) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow(_COLUMNS)
        for view in views:
            numbers = (
                *view.trs_from_cam.translation,
                *view.trs_from_cam.rotation.as_quat(),
                view.terrain_fraction,
                view.lit_fraction,
                view.mean_radiance,
            )
            image = view.image_path.relative_to(path.parent)
            table.writerow([view.view_id, image, *(f"{number:.9g}" for number in numbers)])


def _write_tiff(path: Path, values: NDArray[np.float32]) -> None:
    _write(path, values.astype(np.float32, copy=False))


def _write(path: Path, pixels: NDArray[Any]) -> None:
    import cv2

    _, data = cv2.imencode(path.suffix, pixels)
    with _writing(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data.tobytes())


@contextmanager
def _writing(path: Path) -> Generator[None, None, None]:
    try:
        yield
    except OSError as error:
        raise ConfigError(f"--out: {path} cannot be written: {error.strerror}") from error


def _read_tiff(path: Path) -> NDArray[np.float32]:
    import cv2

    pixels: Any = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    return pixels
