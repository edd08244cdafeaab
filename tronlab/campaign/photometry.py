"""How the paint reflects light, found from a recorded dataset: its images against renderings."""

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from tronlab.calib.inputs import PatchesInput, PhotometryInput
from tronlab.calib.photometry.fit import solve_photometry
from tronlab.calib.photometry.patches import (
    RenderedView,
    patch_size_px,
    patches_of,
    phase_angles,
)
from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.image_quality import FULL_SCALE
from tronlab.campaign.live import Live
from tronlab.campaign.recorded import recorded_heightmap, recorded_lamp
from tronlab.dataset.reader import Dataset
from tronlab.dataset.skeleton import utc_now
from tronlab.errors import DatasetError
from tronlab.geometry.camera import CameraModel
from tronlab.render.heightfield import HeightfieldRenderer
from tronlab.render.photometry import Lambert, LommelSeeliger, Photometry
from tronlab.render.rays import centre_rays
from tronlab.render.renderer import Lamp, Renderer, Rendering
from tronlab.render.settings import RenderSettings

MOST_IMAGES = 40
"""More would say little more, and make the record long."""


def with_photometry(record: CalibrationRecord, measured: PhotometryInput) -> CalibrationRecord:
    """Give a record with the photometry solved from this; all other parts stay as they are.

    Raises:
        CalibrationError: What was measured does not determine the answer, or contradicts itself.
    """
    return replace(
        record,
        created_utc=_utc(utc_now()),
        inputs=record.inputs.with_parts(photometry=measured),
        results=replace(record.results, photometry=solve_photometry(measured)),
    )


def check_rig(dataset_path: Path, record: CalibrationRecord) -> None:
    """See whether a dataset can say how the paint of a record's rig reflects.

    Raises:
        DatasetError: It cannot be read, was imported, or does not follow from one record.
        CalibrationError: It was recorded at another rig.
    """
    with Dataset(dataset_path) as dataset:
        _check_recorded(dataset)
        record.check_rig(dataset.provenance.rig_name)


def measure_photometry(dataset_path: Path, *, rig_path: Path | None, live: Live) -> PhotometryInput:
    """Compare the images of a dataset with renderings from where they were taken.

    Args:
        dataset_path: The dataset.
        rig_path: Where to find the terrain's file, if the recorded rig names one.
        live: Shows how far it is.

    Raises:
        DatasetError: It cannot be read, is damaged, was imported, has no shots that serve, or its
            calibration record no lamp.
        ConfigError: The terrain cannot be found.
        TerrainError: The terrain's file cannot be read.
    """
    with Dataset(dataset_path) as dataset:
        _check_recorded(dataset)
        shots = _shots(dataset)
        comparison = _Comparison.of(dataset, rig_path, live)
        images: list[PatchesInput] = []
        live.advance("images", n_done=0, n_all=len(shots))
        for i in shots:
            images.append(comparison.patches(dataset, i))
            live.advance("images", n_done=len(images), n_all=len(shots))
        return PhotometryInput(
            measured_utc=_utc(dataset.start_time),
            dataset_name=dataset.provenance.campaign_name,
            dataset_uuid=dataset.uuid or "",
            patch_px=comparison.patch_px,
            images=tuple(image for image in images if image.grey),
        )


def _utc(time: str) -> str:
    """Give an ISO 8601 time as a record has it."""
    return f"{datetime.fromisoformat(time).astimezone(UTC):%Y-%m-%dT%H:%M:%SZ}"


def _shots(dataset: Dataset) -> list[int]:
    """Choose shots to look at, evenly spread over those that serve.

    Raises:
        DatasetError: There are none.
    """
    usable = [i for i, state in enumerate(dataset.truth_states) if state != "suspect"]
    if not usable:
        why = "all its shots are suspect" if dataset.n_shots else "it has no shots"
        raise DatasetError(f"{dataset.path}: {why};\nname another dataset of this rig")
    chosen = np.linspace(0, len(usable) - 1, min(len(usable), MOST_IMAGES)).round()
    return [usable[int(i)] for i in chosen]


def _check_recorded(dataset: Dataset) -> None:
    """Refuse a dataset of which lamp and camera are not known.

    Raises:
        DatasetError: It was imported, or does not follow from one calibration record.
    """
    path = dataset.path
    if any(session.kind == "import" for session in dataset.sessions):
        raise DatasetError(
            f"{path}: was imported: nobody knows where lamp and model were;"
            "\nname a dataset that tronlab run recorded"
        )
    if len({session.calibration_json for session in dataset.sessions}) > 1:
        raise DatasetError(
            f"{path}: its sessions have different calibration records, so that lamp and camera are"
            " not the same in all images;\nname a dataset of one record"
        )


@dataclass(frozen=True, slots=True)
class _Comparison:
    """Renders what the images of a dataset should show."""

    renderer: Renderer
    camera: CameraModel
    lamp: Lamp
    patch_px: int

    @classmethod
    def of(cls, dataset: Dataset, rig_path: Path | None, live: Live) -> "_Comparison":
        provenance = dataset.provenance
        record = CalibrationRecord.from_json(
            provenance.calibration_json, source=f"in {dataset.path}"
        )
        if record.results.lamp is None:
            raise DatasetError(
                f"{dataset.path}: its calibration record has no lamp: nobody knows where the light"
                " came from;\nmeasure it: tronlab calibrate lamp, and record a dataset with that"
            )
        lamp = recorded_lamp(provenance, record.results.lamp.p_trs_m)
        heightmap = recorded_heightmap(provenance, rig_path, announce=live.announce)
        live.announce("renderer: preparing the terrain")
        return cls(
            renderer=HeightfieldRenderer(heightmap),
            camera=dataset.camera,
            lamp=lamp,
            patch_px=patch_size_px(dataset.camera.width_px),
        )

    def patches(self, dataset: Dataset, i: int) -> PatchesInput:
        """Give the patches of shot ``i``."""
        frame = dataset.shot(i).frame
        return patches_of(
            frame.image,
            dataset.mask(i),
            self._view(dataset.truth(i).trs_from_cam),
            full_scale=FULL_SCALE[frame.pixel_format],
            patch_px=self.patch_px,
            shot_id=int(dataset.shot_ids[i]),
            exposure_s=frame.exposure_s,
            gain_db=frame.gain_db,
        )

    def _view(self, trs_from_cam: RigidTransform) -> RenderedView:
        def rendered(photometry: Photometry) -> Rendering:
            settings = RenderSettings(photometry=photometry, rays_per_pixel=4)
            return self.renderer.render(self.camera, trs_from_cam, self.lamp, settings)

        lambert = rendered(Lambert())
        rays = centre_rays(self.camera)
        return RenderedView(
            lambert=lambert.radiance,
            lommel_seeliger=rendered(LommelSeeliger()).radiance,
            phase_rad=phase_angles(
                lambert.points_trs_m, self.lamp.p_trs_m, trs_from_cam.translation
            ),
            cos_axis=1.0 / np.sqrt(1.0 + (rays**2).sum(axis=-1)),
        )
