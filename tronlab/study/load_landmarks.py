"""Landmarks to measure the computational load with, from ten thousand to a million."""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.campaign.job import Job
from tronlab.campaign.reference import GreyScale
from tronlab.dataset.records import ReferenceView
from tronlab.errors import PlanError
from tronlab.geometry.camera import CameraModel
from tronlab.nav.database import Landmarks, landmarks_of_view
from tronlab.nav.database_file import Source
from tronlab.nav.database_writer import new_database
from tronlab.nav.features import make_detector
from tronlab.nav.settings import DetectorSettings
from tronlab.nav.view_spread import Spread, spread_poses
from tronlab.render.mask import model_mask
from tronlab.study.load_frames import OnPart

if TYPE_CHECKING:
    from tronlab.terrain.heightmap import HeightMap

LOW_THRESHOLDS: Final = {"akaze": 5e-5, "brisk": 8.0}
"""Of detectors that shall find very many features."""
LANDMARKS_A_VIEW: Final = 10_000
"""Most of a view that fills a database up: five times the usual, for there is no time to render
more views."""

_MOST_FILLING_VIEWS: Final = 400
_RANGE_M: Final = (1.2, 5.0)
_TILT_RAD: Final = float(np.radians(25.0))
_SEED: Final = 5

Part: TypeAlias = tuple[RigidTransform, Landmarks]
"""Pose ``trs_from_cam`` of a view, and the landmarks found in it."""


def database_file(
    folder: Path, features: str, *, image_px: int, n_landmarks: int | None = None
) -> Path:
    """Give the name of a database's file.

    Args:
        folder: Where it is.
        features: Which.
        image_px: Pixels in a row of the views.
        n_landmarks: How many; None: those of the approach.
    """
    return folder / f"{features}-{image_px}-{n_landmarks or 'approach'}.h5"


def make_databases(
    job: Job,
    folder: Path,
    detectors: Sequence[DetectorSettings],
    *,
    image_px: Iterable[int],
    n_landmarks: Sequence[int],
    on_part: OnPart,
) -> None:
    """Find landmarks on the terrain as the laboratory knows it, and write them to files.

    Args:
        job: The campaign, from whose database poses the approach is seen.
        folder: Where to.
        detectors: One for each kind of features.
        image_px: Pixels in a row of images that need a database of the approach.
        n_landmarks: Sizes of databases for images of the calibrated size. The landmarks of the
            approach come first, of each view alike; then those of views spread over the terrain.
        on_part: Told of the views done.

    Raises:
        PlanError: The terrain does not have so many landmarks.
        ScoreError: There are too few to serve any shot.
    """
    views = _Views(job)
    standard = job.calibration.camera
    sides = sorted({*image_px, standard.width_px})
    approach: list[list[Part]] = []
    for n_done, side_px in enumerate(sides):
        on_part(n_done, len(sides))
        camera = standard.scaled(side_px)
        found = _by_detector(views.look(camera, job.reference_poses, detectors), len(detectors))
        for settings, parts in zip(detectors, found, strict=True):
            path = database_file(folder, settings.features, image_px=side_px)
            _save(path, job, settings, parts)
        if side_px == standard.width_px:
            approach = found
    if not n_landmarks:
        return
    filling = _filling(
        views, standard, detectors, approach, n_most=max(n_landmarks), on_part=on_part
    )
    for settings, first, rest in zip(detectors, approach, filling, strict=True):
        for n in n_landmarks:
            path = database_file(
                folder, settings.features, image_px=standard.width_px, n_landmarks=n
            )
            _save(path, job, settings, so_many(first, rest, n))


class _Views:
    """What the terrain as it is known looks like."""

    def __init__(self, job: Job) -> None:
        from tronlab.render.registry import open_renderer

        self._settings = config = job.database_images
        self._lamp = job.lamp
        self.heightmap = job.rig.load_heightmap()
        self._renderer = open_renderer(config.renderer, self.heightmap, every_n=config.every_n)

    def look(
        self,
        camera: CameraModel,
        poses: Iterable[RigidTransform],
        detectors: Sequence[DetectorSettings],
    ) -> Iterator[tuple[RigidTransform, list[Landmarks]]]:
        """Give each pose that sees lit terrain, with the landmarks of each detector."""
        finders = [make_detector(settings) for settings in detectors]
        for i, pose in enumerate(poses):
            rendering = self._renderer.render(camera, pose, self._lamp, self._settings)
            try:
                scale = GreyScale.of([rendering.radiance])
            except PlanError:
                continue  # in the dark there are no landmarks
            is_model = model_mask(self.heightmap, camera, pose)
            view = ReferenceView(
                view_id=i + 1,
                trs_from_cam=pose,
                image=scale.grey(rendering.radiance),
                depth_m=rendering.depth_m,
                mask=is_model & np.isfinite(rendering.depth_m),
            )
            yield pose, [landmarks_of_view(view, camera, finder) for finder in finders]


def _filling(
    views: _Views,
    camera: CameraModel,
    detectors: Sequence[DetectorSettings],
    approach: Sequence[Sequence[Part]],
    *,
    n_most: int,
    on_part: OnPart,
) -> list[list[Part]]:
    """Find landmarks all over the terrain until there are enough with those of the approach.

    Raises:
        PlanError: There are not so many.
    """
    crowded = [_crowded(settings) for settings in detectors]
    filling: list[list[Part]] = [[] for _ in detectors]
    n_found = [_count(parts) for parts in approach]
    seen = views.look(camera, _spread(views.heightmap), crowded)
    while min(n_found) < n_most:
        on_part(min(n_found), n_most)
        view = next(seen, None)
        if view is None:
            raise PlanError(
                f"load.n_landmarks: {_MOST_FILLING_VIEWS} views of the terrain have"
                f" {min(n_found)} landmarks, {n_most} are asked for; ask for fewer"
            )
        for i, found in enumerate(view[1]):
            filling[i].append((view[0], found))
            n_found[i] += len(found)
    on_part(n_most, n_most)
    return filling


def so_many(approach: Sequence[Part], filling: Sequence[Part], n: int) -> list[Part]:
    """Give ``n`` landmarks, or a few more: of each view of the approach alike, then the others."""
    share = min(1.0, n / _count(approach))
    chosen = [(pose, _first(found, int(np.ceil(share * len(found))))) for pose, found in approach]
    n_left = n - _count(chosen)
    for pose, found in filling:
        if n_left <= 0:
            break
        chosen.append((pose, _first(found, n_left)))
        n_left -= len(found)
    return chosen


def _by_detector(
    seen: Iterable[tuple[RigidTransform, list[Landmarks]]], n_detectors: int
) -> list[list[Part]]:
    parts: list[list[Part]] = [[] for _ in range(n_detectors)]
    for pose, found in seen:
        for i, landmarks in enumerate(found):
            parts[i].append((pose, landmarks))
    return parts


def _count(parts: Iterable[Part]) -> int:
    return sum(len(found) for _, found in parts)


def _first(landmarks: Landmarks, n: int) -> Landmarks:
    """Give the first ones, which are the strongest of each part of their view."""
    return Landmarks(landmarks.p_trs_m[:n], landmarks.size_m[:n], landmarks.descriptors[:n])


def _save(path: Path, job: Job, settings: DetectorSettings, parts: Sequence[Part]) -> None:
    with new_database(path, settings) as writer:
        writer.sources.append(
            Source(
                kind="campaign",
                name=job.campaign.path.name,
                identity=job.campaign.path.name,
                camera=job.calibration.camera.to_dict(),
                rig=job.rig.name,
                views="database poses of the campaign, then views spread over the terrain",
            )
        )
        for pose, found in parts:
            writer.add(pose, found, source=0)


def _crowded(settings: DetectorSettings) -> DetectorSettings:
    changes = {"threshold": LOW_THRESHOLDS[settings.features], "n_max": LANDMARKS_A_VIEW}
    return settings.model_copy(update=changes)


def _spread(heightmap: "HeightMap") -> tuple[RigidTransform, ...]:
    x_m, y_m, _ = heightmap.origin_trs_m
    statistics = heightmap.statistics
    return spread_poses(
        Spread(_MOST_FILLING_VIEWS, _RANGE_M, _TILT_RAD, _SEED),
        corner_trs_m=np.array([x_m, y_m, heightmap.mean_height_trs_m]),
        size_m=heightmap.size_m,
        clearance_m=statistics.highest_m - statistics.mean_m,
    )
