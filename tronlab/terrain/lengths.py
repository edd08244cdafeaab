"""Lengths from micrometres to kilometres, as people read them."""


def height_unit(relief_m: float) -> tuple[float, str]:
    """Give the factor from metres, and the name, of a unit fit for heights."""
    return (1e3, "mm") if relief_m < 1.0 else (1.0, "m")


def length_text(length_m: float) -> str:
    """Give a length with a unit that keeps its number short."""
    for least_m, unit_m, unit in ((1e3, 1e3, "km"), (1.0, 1.0, "m"), (1e-4, 1e-3, "mm")):
        if length_m >= least_m:
            number = length_m / unit_m
            return f"{number:.4g} {unit}" if number < 1e4 else f"{number:.0f} {unit}"
    return f"{length_m / 1e-6:.3g} um"
