"""Light, shadows and depth of our renderers beside another's, pixel by pixel: prints a table.

    python benchmarks/radiance.py [--against mitsuba] [--renderer NAME ...] [--every-n 2]

Needs the extra of the renderer compared with. All get the same samples of the laboratory's model
and look at it from 1 m, 4 m and 10 m, with each photometric function and with a lamp that is a
point or a sphere; last with everything at once: an albedo map, a spot cone, light from everywhere,
vignetting and four rays a pixel. A ratio is that of the radiances where both see the lamp.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from peers import View, figures_lamp, figures_views

from tronlab.geometry.poses import unit
from tronlab.render.photometry import Hapke, Lambert, LommelSeeliger, LunarLambert
from tronlab.render.registry import open_renderer, renderer_names
from tronlab.render.renderer import Lamp, Renderer, RenderError, Rendering, SpotCone
from tronlab.render.settings import RenderSettings, Shadows
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.heightmap import HeightMap
from tronlab.terrain.load import load_terrain

LAMP_RADIUS_M = 0.03
FUNCTIONS = (Lambert(), LommelSeeliger(), LunarLambert(), Hapke())


class Case(NamedTuple):
    """How one image is lit and made."""

    name: str
    lamp: Lamp
    settings: RenderSettings


def cases(heightmap: HeightMap, shadows: Shadows) -> list[Case]:
    """Give the rows of the table; lights at points, as another renderer has them."""
    point = figures_lamp(heightmap)
    sphere = replace(point, radius_m=LAMP_RADIUS_M)
    aim = heightmap.origin_trs_m + np.array([0.5 * size_m for size_m in heightmap.size_m] + [0.0])
    beam = unit(aim - point.p_trs_m)
    spot = replace(sphere, cone=SpotCone(beam, np.radians(3.0), np.radians(8.0)))
    every = RenderSettings(
        photometry=Hapke(),
        rays_per_pixel=4,
        shadows=shadows,
        prefilter=False,
        ambient=0.002,
        vignetting_power=4,
    )
    plain = [
        RenderSettings(photometry=function, shadows=shadows, prefilter=False)
        for function in FUNCTIONS
    ]
    return [
        *(Case(f"{settings.photometry.kind}, point", point, settings) for settings in plain),
        *(Case(f"{settings.photometry.kind}, sphere", sphere, settings) for settings in plain),
        Case("everything", spot, every),
    ]


def rendered(renderer: Renderer, view: View, case: Case) -> tuple[Rendering, float]:
    """Give an image and the processor's seconds."""
    started = time.process_time()
    rendering = renderer.render(view.camera, view.trs_from_cam, case.lamp, case.settings)
    return rendering, time.process_time() - started


def compare(ours: Rendering, other: Rendering) -> str:
    """Give the differences as a line of text."""
    seen, other_seen = np.isfinite(ours.depth_m), np.isfinite(other.depth_m)
    both = seen & other_seen
    lit = ours.is_lit & other.is_lit & (other.radiance > 0)
    if not lit.any():
        return f"nothing is lit in both (ours {ours.is_lit.mean():.1%})"
    ratio = ours.radiance[lit].astype(np.float64) / other.radiance[lit]
    low, median, high = np.quantile(ratio, [0.01, 0.5, 0.99])
    shadow = np.count_nonzero((ours.is_lit != other.is_lit) & both) / np.count_nonzero(both)
    depth_um = np.quantile(np.abs(ours.depth_m - other.depth_m)[both], [0.5, 0.999]) * 1e6
    return (
        f"ratio {median:.5f} ({low:.4f} to {high:.4f})  shadow differs {shadow:.3%}"
        f"  depth p50 {depth_um[0]:.2f} p99.9 {depth_um[1]:.2f} um"
        f"  hit/miss differs {np.count_nonzero(seen != other_seen)}"
        f"  lit {ours.is_lit[both].mean():.1%}"
    )


def albedo_of(heightmap: HeightMap) -> np.ndarray:
    """Give an albedo map of patches between 0.3 and 1."""
    rows, columns = heightmap.height_m.shape
    x, y = np.ogrid[:rows, :columns]
    waves = np.sin(x * heightmap.spacing_m * 9) * np.sin(y * heightmap.spacing_m * 13)
    return (65535 * (0.65 + 0.35 * waves)).astype(np.uint16)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", default="mitsuba", choices=renderer_names())
    parser.add_argument("--renderer", nargs="*", default=["reference", "heightfield"])
    parser.add_argument("--every-n", type=int, default=2)
    parser.add_argument("--shadows", default="map", choices=["map", "rays"])
    parser.add_argument("--view", nargs="*")
    parser.add_argument("--case", nargs="*", help="only cases whose names have one of these")
    arguments = parser.parse_args()
    full = load_terrain(ProceduralTerrain(), base_dir=Path(), announce=print)
    n = arguments.every_n
    heights = np.ascontiguousarray(full.height_m[::n, ::n])
    heightmap = HeightMap(heights, full.spacing_m * n, full.origin_trs_m)
    albedo = albedo_of(heightmap)
    names = [arguments.against, *arguments.renderer]
    renderers = {
        name: open_renderer(name, heightmap.painted(albedo), announce=print) for name in names
    }
    for view_name, view in figures_views(heightmap).items():
        if arguments.view and view_name not in arguments.view:
            continue
        for case in cases(heightmap, arguments.shadows):
            if arguments.case and not any(part in case.name for part in arguments.case):
                continue
            try:
                other, other_s = rendered(renderers[arguments.against], view, case)
            except RenderError as error:
                print(f"{view_name}, {case.name}: {error}")
                continue
            for name in arguments.renderer:
                ours, ours_s = rendered(renderers[name], view, case)
                print(
                    f"{view_name:11s} {case.name:23s} {name:11s} {compare(ours, other)}"
                    f"  cpu {ours_s:.2f} ({arguments.against} {other_s:.2f}) s",
                    flush=True,
                )


if __name__ == "__main__":
    main()
