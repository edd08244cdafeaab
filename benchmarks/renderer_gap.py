"""How far apart two renderers are: light, shadows and features at the same poses; prints a table.

    python benchmarks/renderer_gap.py [--against cycles] [--renderer NAME ...] [--view NAME ...]
                                      [--picture docs/images/renderer_gap.jpg]

A database from another renderer than the laboratory images' is a test of navigation only as far as
the renderers differ. Both look at the laboratory's model from 1 m (of its middle every sample, as
another renderer has no room for all), 4 m and 10 m (of all of it every second sample), and once
more from 4 m through a lens with distortion. Light and shadows are compared at points; features in
8-bit images of one grey scale: of points, with the usual settings and with four rays a pixel. A
feature of ours has its like where the other image's feature with the nearest descriptor lies within
1 px of it; back: the same for the other's features.
"""

import argparse
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from peers import View, figures_lamp, figures_views

from tronlab.campaign.reference import GreyScale
from tronlab.nav.features import AKAZE, Features, detect_features
from tronlab.render.registry import open_renderer, renderer_names
from tronlab.render.renderer import PLAIN, Lamp, Renderer, Rendering
from tronlab.render.settings import RenderSettings
from tronlab.terrain.config import ProceduralTerrain
from tronlab.terrain.heightmap import HeightMap
from tronlab.terrain.load import load_terrain

LIKE_PX = 1.0
DISTORTION = (-0.12, 0.05, 3e-4, -2e-4)
PICTURED = "4 m oblique"
NEAR = "1 m nadir"
MIDDLE_M = 1.5
PANEL_PX = 480
HOWS = {
    "points": RenderSettings(prefilter=False),
    "usual": PLAIN,
    "4 rays": RenderSettings(rays_per_pixel=4),
}


class Likes(NamedTuple):
    """Features of ours, and which have their like in the other image."""

    ours: Features
    other: Features
    is_like: np.ndarray


def gap(ours: Rendering, other: Rendering) -> str:
    """Give the ratio of radiances, its spread, and the share of points that one alone has lit."""
    both = np.isfinite(ours.depth_m) & np.isfinite(other.depth_m)
    lit = both & ours.is_lit & other.is_lit
    low, median, high = np.quantile(ours.radiance[lit] / other.radiance[lit], [0.01, 0.5, 0.99])
    shadow = np.mean(ours.is_lit[both] != other.is_lit[both])
    return f" ratio {median:.5f} ({low:.4f} to {high:.4f}), shadow differs {shadow:.3%},"


def likes(ours: np.ndarray, other: np.ndarray, mask: np.ndarray) -> Likes:
    found, other_found = (detect_features(image, mask, AKAZE) for image in (ours, other))
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    nearest = [
        match.trainIdx for match in matcher.match(found.descriptors, other_found.descriptors)
    ]
    apart_px = np.linalg.norm(found.uv - other_found.uv[nearest], axis=1)
    return Likes(found, other_found, apart_px <= LIKE_PX)


def grey_images(one: Rendering, two: Rendering) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Give the 8-bit images of both, and where both show terrain."""
    scale = GreyScale.of([one.radiance])
    mask = np.isfinite(one.depth_m) & np.isfinite(two.depth_m)
    return scale.grey(one.radiance), scale.grey(two.radiance), mask


def features_line(images: tuple[np.ndarray, np.ndarray, np.ndarray], found: Likes) -> str:
    ours, other, mask = images
    back = likes(other, ours, mask)
    grey_rms = np.sqrt(np.mean((ours[mask].astype(float) - other[mask]) ** 2))
    return (
        f" grey rms {grey_rms:.2f}, AKAZE {len(found.ours)} and {len(found.other)} features,"
        f" with their like {found.is_like.mean():.2%}, back {back.is_like.mean():.2%}"
    )


def timed(renderer: Renderer, view: View, lamp: Lamp, settings: RenderSettings) -> Rendering:
    started = time.perf_counter()
    rendering = renderer.render(view.camera, view.trs_from_cam, lamp, settings)
    print(f"  the other one took {time.perf_counter() - started:.2f} s")
    return rendering


def picture(
    path: Path, images: tuple[np.ndarray, np.ndarray, np.ndarray], found: Likes, against: str
) -> None:
    """Write both images, their difference and our features as a picture of four panels."""
    ours, other, mask = images
    difference = 128 + 4 * (ours.astype(np.int16) - other)
    panels = {
        "tronlab": ours,
        against: other,
        "difference x 4": difference.clip(0, 255).astype(np.uint8),
        f"features with their like: {found.is_like.mean():.1%}": ours,
    }
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    top, left = rows[0], columns[0]
    scale = PANEL_PX / (columns[-1] + 1 - left)
    drawn = []
    for title, image in panels.items():
        part = image[top : rows[-1] + 1, left : columns[-1] + 1]
        small = cv2.resize(part, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        panel = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
        if title.startswith("features"):
            for uv, is_like in zip(found.ours.uv, found.is_like, strict=True):
                centre = np.rint((uv + 0.5 - [left, top]) * scale).astype(int)
                cv2.circle(panel, centre.tolist(), 2, (80, 200, 80) if is_like else (60, 60, 255))
        cv2.rectangle(panel, (0, 0), (9 * len(title) + 10, 24), (0, 0, 0), cv2.FILLED)
        cv2.putText(panel, title, (6, 17), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255, 255, 255), 1, 16)
        drawn.append(panel)
    sheet = np.vstack([np.hstack(drawn[:2]), np.hstack(drawn[2:])])
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), sheet, [cv2.IMWRITE_JPEG_QUALITY, 82])
    print(f"{path}: {path.stat().st_size / 1e3:.0f} kB")


def middle_of(full: HeightMap) -> HeightMap:
    """Give a square in the middle, all that is seen from 1 m."""
    n = round(MIDDLE_M / full.spacing_m)
    i, j = ((count - n) // 2 for count in full.height_m.shape)
    corner_m = full.origin_trs_m + np.array([i, j, 0]) * full.spacing_m
    return HeightMap(full.height_m[i : i + n, j : j + n].copy(), full.spacing_m, corner_m)


def every_second(full: HeightMap) -> HeightMap:
    return HeightMap(full.height_m[::2, ::2].copy(), full.spacing_m * 2, full.origin_trs_m)


def compare(
    names: list[str], against: str, heightmap: HeightMap, views: dict[str, View], sheet: Path | None
) -> None:
    """Print the lines of some views of a terrain, and draw one of them."""
    lamp = figures_lamp(heightmap)
    other = open_renderer(against, heightmap, announce=print)
    renderers = {name: open_renderer(name, heightmap) for name in names}
    for view_name, view in views.items():
        print(view_name)
        others = {how: timed(other, view, lamp, settings) for how, settings in HOWS.items()}
        for renderer_name, renderer in renderers.items():
            for how, settings in HOWS.items():
                if renderer_name == "reference" and settings.prefilter:
                    continue  # it has only points
                ours = renderer.render(view.camera, view.trs_from_cam, lamp, settings)
                print(f"  {renderer_name:11s} {how:8s}", end="")
                if not settings.prefilter:
                    print(gap(ours, others[how]), end="")
                images = grey_images(ours, others[how])
                found = likes(*images)
                print(features_line(images, found), flush=True)
                if sheet is not None and view_name == PICTURED:
                    picture(sheet, images, found, against)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--against", default="cycles", choices=renderer_names())
    parser.add_argument("--renderer", nargs="*", default=["reference", "heightfield"])
    parser.add_argument("--view", nargs="*", help="only views whose names begin like this")
    parser.add_argument("--picture", type=Path)
    arguments = parser.parse_args()
    full = load_terrain(ProceduralTerrain(), base_dir=Path(), announce=print)
    views = figures_views(full)
    camera, pose = views[PICTURED]
    views[f"{PICTURED}, bent"] = View(replace(camera, distortion=DISTORTION), pose)
    if arguments.view:
        views = {k: v for k, v in views.items() if k.startswith(tuple(arguments.view))}
    near = {name: view for name, view in views.items() if name == NEAR}
    far = {name: view for name, view in views.items() if name != NEAR}
    for terrain_of, seen in ((middle_of, near), (every_second, far)):
        if seen:
            sheet = arguments.picture
            compare(arguments.renderer, arguments.against, terrain_of(full), seen, sheet)


if __name__ == "__main__":
    main()
