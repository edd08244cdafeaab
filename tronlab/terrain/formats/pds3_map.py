"""Where the samples of a PDS3 image lie, from its IMAGE_MAP_PROJECTION."""

import math

from tronlab.terrain.formats.georeference import Place
from tronlab.terrain.formats.model import Announce
from tronlab.terrain.formats.pds3_label import Label, Section

_CYLINDRICAL = ("SIMPLE_CYLINDRICAL", "EQUIRECTANGULAR")
_STEREOGRAPHIC = ("POLAR_STEREOGRAPHIC",)


def place_of(label: Label, announce: Announce) -> Place | None:
    """Give spacing, place of the first sample and reference system; None if the label has no map.

    Raises:
        TerrainError: The map has a keyword that makes no sense.
    """
    section = label.section("IMAGE_MAP_PROJECTION")
    if section is None:
        announce(f"{label.path.name}: says neither how far apart samples are nor where they lie")
        return None
    spacing_m = _spacing_m(label, section)
    crs = _wkt(label, section)
    if crs is None:
        kind = label.word(section, "MAP_PROJECTION_TYPE", "no projection")
        announce(f"{label.path.name}: the place on the map ({kind}) is not carried over")
        return Place((spacing_m, spacing_m), None, None)
    # Both offsets count samples from the centre of the first one to the origin of the projection.
    x_px = -label.number(section, "SAMPLE_PROJECTION_OFFSET")[0]
    y_px = label.number(section, "LINE_PROJECTION_OFFSET")[0]
    return Place((spacing_m, spacing_m), (x_px * spacing_m, y_px * spacing_m), crs)


def radius_m(label: Label, section: Section) -> float | None:
    """Give the radius of the body if it is a sphere."""
    axes = [f"{axis}_AXIS_RADIUS" for axis in "ABC"]
    if any(axis not in section for axis in axes):
        return None
    radii = {label.number(section, axis) for axis in axes}
    if len(radii) != 1:
        return None
    radius, unit = radii.pop()
    return radius * (1.0 if unit in ("M", "METER", "METERS") else 1000.0)


def _spacing_m(label: Label, section: Section) -> float:
    """Give MAP_SCALE, which is in km/pixel unless it names a unit."""
    scale, unit = label.number(section, "MAP_SCALE")
    length = unit.partition("/")[0]
    if length in ("", "KM", "KILOMETER", "KILOMETERS"):
        scale *= 1000.0
    elif length not in ("M", "METER", "METERS"):
        raise label.error(f"gives MAP_SCALE in {unit}, allowed are km/pixel and m/pixel")
    if not scale > 0.0:
        raise label.error(f"gives MAP_SCALE as {scale} m, must be positive")
    return scale


def _wkt(label: Label, section: Section) -> str | None:
    """Give the map as WKT 1 (OGC 01-009) where it is one of a few usual ones on a sphere."""
    kind = label.word(section, "MAP_PROJECTION_TYPE")
    body_radius_m = radius_m(label, section)
    is_usual = (
        body_radius_m is not None
        and label.word(section, "POSITIVE_LONGITUDE_DIRECTION", "EAST") == "EAST"
        and label.number(section, "MAP_PROJECTION_ROTATION", 0.0)[0] == 0.0
        and "SAMPLE_PROJECTION_OFFSET" in section
        and "LINE_PROJECTION_OFFSET" in section
    )
    if not is_usual or kind not in _CYLINDRICAL + _STEREOGRAPHIC:
        return None
    latitude_deg = label.number(section, "CENTER_LATITUDE")[0]
    parameters = {"central_meridian": label.number(section, "CENTER_LONGITUDE")[0]}
    if kind in _CYLINDRICAL:
        projection = "Equirectangular"
        parameters["standard_parallel_1"] = latitude_deg
    else:
        projection = "Polar_Stereographic"
        parameters["latitude_of_origin"] = latitude_deg
        parameters["scale_factor"] = 1.0
    parameters |= {"false_easting": 0.0, "false_northing": 0.0}
    body = label.word(label.sections, "TARGET_NAME", "BODY")
    listed = ",".join(f'PARAMETER["{name}",{value!r}]' for name, value in parameters.items())
    return (
        f'PROJCS["{kind} {body}",GEOGCS["GCS_{body}",DATUM["D_{body}",SPHEROID["{body}",'
        f'{body_radius_m!r},0]],PRIMEM["Reference_Meridian",0],'
        f'UNIT["degree",{math.radians(1)!r}]],PROJECTION["{projection}"],{listed},'
        f'UNIT["metre",1]]'
    )
