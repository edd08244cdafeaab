"""Setting the region of the sensor that is read out."""

from drivers.gige.features import HEIGHT, LEFT, TOP, WIDTH, Features
from drivers.gige.options import Region


def read_out(region: Region | None, features: Features, *, call: str) -> None:
    """Read out a region of the sensor, or all of it.

    Raises:
        LimitError: The sensor has no such region; the message says what is allowed.
    """
    for offset in (LEFT, TOP):
        if features.has(offset.name):  # how wide the region may be depends on where it begins
            features.set_number(offset, 0, call=call)
    if region is None:
        for size in (WIDTH, HEIGHT):
            features.set_number(size, features.largest(size, call=call), call=call)
        return
    features.set_number(WIDTH, region.width_px, call=call)
    features.set_number(HEIGHT, region.height_px, call=call)
    for offset, value in ((LEFT, region.left_px), (TOP, region.top_px)):
        if value != 0 or features.has(offset.name):
            features.set_number(offset, value, call=call)
