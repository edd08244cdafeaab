"""Entry point of the driver: makes a camera where the packages for it are installed."""

import warnings
from typing import TYPE_CHECKING

from drivers.gige.options import CameraOptions
from tronlab.devices.registry import DeviceContext
from tronlab.errors import ConfigError

if TYPE_CHECKING:
    from drivers.gige.camera import GigeCamera


def open_camera(context: DeviceContext) -> "GigeCamera":
    """Make the camera; nothing is connected yet.

    Raises:
        ConfigError: The options do not fit, or the packages this driver needs are not installed.
    """
    options = context.parse_options(CameraOptions)
    try:
        with warnings.catch_warnings():  # harvesters changes the filters of the whole process
            warnings.simplefilter("ignore", DeprecationWarning)  # of genicam's SWIG modules
            from drivers.gige.camera import GigeCamera
    except ModuleNotFoundError as error:
        raise ConfigError(
            f"this driver needs the package {error.name}; run: pip install 'tronlab[lab]'",
            key=f"devices.{context.name}.driver",
        ) from error
    return GigeCamera(options, name=context.name, base_dir=context.base_dir)
