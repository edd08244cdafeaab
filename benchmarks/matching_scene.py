"""Real descriptors by the million: rendered views of the laboratory's terrain, kept in a folder.

The database's views are rendered with Lambert's law; the queries with another photometry, four rays
a pixel, the lamp 3 cm elsewhere, blur, noise and 8 bit. Camera and lamp are those of the twin's rig
file. ``matching.py`` uses it; alone it makes a folder:

    python benchmarks/matching_scene.py FOLDER [--n-views 600]
"""

import argparse
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import RigidTransform

from tronlab.dataset.records import ReferenceView
from tronlab.geometry.camera import CameraModel
from tronlab.geometry.poses import pose_along_boresight
from tronlab.nav.database import LANDMARK_ARRAYS, Database, find_landmarks
from tronlab.nav.features import Features, detect_features, make_detector
from tronlab.nav.settings import DetectorSettings
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.render.mask import model_mask
from tronlab.render.renderer import Lamp
from tronlab.render.settings import RenderSettings
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.load import load_terrain

DETECTORS = {
    "akaze": DetectorSettings(features="akaze"),
    "brisk": DetectorSettings(features="brisk"),
}
CAMERA = CameraModel(1024, 1024, 767.4, 767.4, 511.5, 511.5, (-0.10, 0.09, 4e-4, -3e-4, 0.0))
LAMP_TRS_M = np.array([-3.0, -2.5, 3.5])
LAMP_MOVED_M = np.array([0.02, -0.02, 0.01])
NEAREST_M, FARTHEST_M = 1.0, 5.0
MAX_TILT_DEG = 25.0
GREY_OF_BRIGHT = 220.0
BLUR_SIGMA_PX = 0.6
ELECTRONS_PER_GREY = 60.0
READ_NOISE_GREY = 0.2
QUERY_SETTINGS = RenderSettings.model_validate(
    {"photometry": "lunar_lambert", "rays_per_pixel": 4, "ambient": 0.002}
)
N_QUERIES = 30
_QUERIES = "queries.npz"
_CHUNK = 20
_VIEW_SEED, _QUERY_SEED = 1, 2


@dataclass(frozen=True)
class Query:
    """An image whose pose is known."""

    trs_from_cam: RigidTransform
    image: NDArray[np.uint8]
    mask: NDArray[np.bool_]
    features: dict[str, Features]
    """By detector."""


def random_poses(rng: np.random.Generator, n: int, size_m: Sequence[float]) -> list[RigidTransform]:
    """Draw poses ``trs_from_cam`` over the model: tilted, and turned about the optical axis."""
    poses = []
    for _ in range(n):
        target = np.array([*(rng.uniform(0.15, 0.85, 2) * size_m), 0.1])
        range_m = NEAREST_M * (FARTHEST_M / NEAREST_M) ** rng.random()
        tilt = np.radians(MAX_TILT_DEG) * np.sqrt(rng.random())
        azimuth, roll = rng.uniform(-np.pi, np.pi, 2)
        across = np.sin(tilt) * np.array([np.cos(azimuth), np.sin(azimuth)])
        boresight = np.array([*across, -np.cos(tilt)])
        right = [np.cos(roll), np.sin(roll), 0.0]
        position_m = target - range_m * boresight
        poses.append(pose_along_boresight(position_m, boresight=boresight, right=right))
    return poses


def make_folder(folder: Path, *, n_views: int, n_processes: int = 2) -> None:
    """Render and detect what is not in the folder yet."""
    folder.mkdir(parents=True, exist_ok=True)
    heightmap = load_terrain(ProceduralTerrain(), base_dir=Path(), announce=print)
    poses = random_poses(np.random.default_rng(_VIEW_SEED), n_views, heightmap.size_m)
    chunks = [
        (first, poses[first : first + _CHUNK], folder / f"views_{first:05}.npz")
        for first in range(0, n_views, _CHUNK)
    ]
    missing = [chunk for chunk in chunks if not chunk[2].exists()]
    with ProcessPoolExecutor(n_processes) as pool:
        for n, _ in enumerate(pool.map(_make_views, missing), start=1):
            print(f"{n} of {len(missing)} parts of the database", flush=True)
    if not (folder / _QUERIES).exists():
        _make_queries(folder / _QUERIES, N_QUERIES)


def load_database(folder: Path, detector: str, n_max: int) -> Database:
    """Give the landmarks of as many views as it takes, ``n_max`` at most."""
    parts: list[dict[str, NDArray[Any]]] = []
    n = 0
    for path in sorted(folder.glob("views_?????.npz")):
        with np.load(path) as kept:
            parts.append({name: kept[f"{detector}_{name}"] for name in LANDMARK_ARRAYS})
        n += len(parts[-1]["view"])
        if n >= n_max:
            break
    arrays = {name: np.concatenate([p[name] for p in parts])[:n_max] for name in LANDMARK_ARRAYS}
    size_m = load_terrain(ProceduralTerrain(), base_dir=Path()).size_m
    poses = random_poses(np.random.default_rng(_VIEW_SEED), 1 + arrays["view"].max(), size_m)
    eyes = np.array([pose.translation for pose in poses])
    return Database(**arrays, p_views_trs_m=eyes, detector=DETECTORS[detector])


def load_queries(folder: Path, n: int) -> Iterator[Query]:
    """Give the first queries."""
    with np.load(folder / _QUERIES) as kept:
        arrays = dict(kept)
    for i in range(n):
        yield Query(
            RigidTransform.from_matrix(arrays["trs_from_cam"][i]),
            arrays["image"][i],
            arrays["mask"][i],
            {
                name: Features(*(arrays[f"{name}_{i}_{what}"] for what in ("uv", "size", "bits")))
                for name in DETECTORS
            },
        )


def _make_views(chunk: tuple[int, list[RigidTransform], Path]) -> None:
    first, poses, path = chunk
    cv2.setNumThreads(1)
    heightmap = load_terrain(ProceduralTerrain(), base_dir=Path())
    renderer = HeightfieldRenderer(heightmap, n_threads=1)
    renderings = renderer.render_batch(CAMERA, poses, Lamp(LAMP_TRS_M, 1.0))
    views = [
        ReferenceView(
            view_id=first + i,
            trs_from_cam=pose,
            image=_grey(rendering.radiance),
            depth_m=rendering.depth_m,
            mask=model_mask(heightmap, CAMERA, pose) & np.isfinite(rendering.depth_m),
        )
        for i, (pose, rendering) in enumerate(zip(poses, renderings, strict=True))
    ]
    arrays: dict[str, NDArray[Any]] = {}
    for name, detector in DETECTORS.items():
        database = find_landmarks(views, CAMERA, detector)
        arrays |= {
            f"{name}_p_trs_m": database.p_trs_m,
            f"{name}_size_m": database.size_m,
            f"{name}_descriptors": database.descriptors,
            f"{name}_view": database.view + first,
        }
    partial_path = path.with_suffix(".partial.npz")
    np.savez(partial_path, **arrays)
    partial_path.rename(path)


def _make_queries(path: Path, n: int) -> None:
    rng = np.random.default_rng(_QUERY_SEED)
    heightmap = load_terrain(ProceduralTerrain(), base_dir=Path())
    poses = random_poses(rng, n, heightmap.size_m)
    renderer = HeightfieldRenderer(heightmap)
    lamp = Lamp(LAMP_TRS_M + LAMP_MOVED_M, 1.0)
    renderings = list(renderer.render_batch(CAMERA, poses, lamp, QUERY_SETTINGS))
    images = [_noisy(rng, _grey(r.radiance, np.float64)) for r in renderings]
    masks = [model_mask(heightmap, CAMERA, pose) for pose in poses]
    arrays: dict[str, Any] = {
        "trs_from_cam": np.stack([pose.as_matrix() for pose in poses]),
        "image": np.stack(images),
        "mask": np.stack(masks),
    }
    for i, (image, mask) in enumerate(zip(images, masks, strict=True)):
        for name, detector in DETECTORS.items():
            found = detect_features(image, mask, make_detector(detector))
            arrays |= {
                f"{name}_{i}_uv": found.uv,
                f"{name}_{i}_size": found.size_px,
                f"{name}_{i}_bits": found.descriptors,
            }
    np.savez(path, **arrays)


def _grey(radiance: NDArray[np.float32], dtype: Any = np.uint8) -> NDArray[Any]:
    """Expose each image for itself, as the campaigns do."""
    lit = radiance[radiance > 0]
    scale = GREY_OF_BRIGHT / float(np.percentile(lit, 99.0)) if lit.size else 1.0
    grey = np.clip(radiance * scale, 0, 255)
    return np.rint(grey).astype(dtype) if dtype is np.uint8 else grey.astype(dtype)


def _noisy(rng: np.random.Generator, grey: NDArray[np.float64]) -> NDArray[np.uint8]:
    blurred = gaussian_filter(grey, BLUR_SIGMA_PX)
    photons = rng.poisson(blurred * ELECTRONS_PER_GREY) / ELECTRONS_PER_GREY
    noisy = photons + READ_NOISE_GREY * rng.standard_normal(grey.shape)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def main() -> None:
    """Make the folder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--n-views", type=int, default=600)
    arguments = parser.parse_args()
    make_folder(arguments.folder, n_views=arguments.n_views)


if __name__ == "__main__":
    main()
