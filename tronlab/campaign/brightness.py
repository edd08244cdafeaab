"""How bright the model ought to be: a small rendering with the calibrated camera and lamp."""

from dataclasses import dataclass

from scipy.spatial.transform import RigidTransform

from tronlab.geometry.camera import CameraModel
from tronlab.render.mask import model_mask
from tronlab.render.photometry import Photometry
from tronlab.render.renderer import Lamp, Renderer
from tronlab.render.settings import RenderSettings
from tronlab.terrain.heightmap import HeightMap

WIDTH_PX = 64
"""Of the rendering: enough for a mean, a thousandth of the rays of an image."""


@dataclass(frozen=True)
class LightModel:
    """Predicts how bright the model is from a pose, up to one factor that never changes."""

    renderer: Renderer
    heightmap: HeightMap
    camera: CameraModel
    """That of the images; it is made smaller here."""
    lamp: Lamp
    photometry: Photometry

    def mean_radiance(self, trs_from_cam: RigidTransform) -> float | None:
        """Give the mean radiance of the pixels that show the model; None if it is dark or unseen.

        Args:
            trs_from_cam: Where the camera is.
        """
        camera = self.camera.scaled(WIDTH_PX)
        mask = model_mask(self.heightmap, camera, trs_from_cam)
        if not mask.any():
            return None
        settings = RenderSettings(photometry=self.photometry)
        rendering = self.renderer.render(camera, trs_from_cam, self.lamp, settings)
        mean = float(rendering.radiance[mask].mean())
        return mean if mean > 0 else None
