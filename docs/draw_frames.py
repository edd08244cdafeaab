"""Draw ``docs/images/frames.png``: python docs/draw_frames.py [PICTURE.png].

Everything stands where the rig file ``campaigns/rigs/twin.yaml`` puts it; the tracker, which has no
designed place, where the calibration record of that rig found it.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.spatial.transform import RigidTransform

from tronlab.calib.record import CalibrationRecord
from tronlab.campaign.rig import Rig, load_rig
from tronlab.devices.laboratory import LaboratorySpec
from tronlab.geometry.poses import CAM_FROM_BLENDER_CAM, FloatArray, pose_along_boresight
from tronlab.terrain.load import load_terrain

ROOT = Path(__file__).resolve().parents[1]
P_CAM_TRS_M = (1.08, 2.08, 2.5)
"""Where the camera of the picture stands: half way along the straight line of the paper."""
AXIS_COLOURS = ("#d62728", "#2ca02c", "#1f4fd8")
CHAIN = "#8a2be2"
MUTED = "0.45"


@dataclass(frozen=True, slots=True)
class View:
    """An orthographic view of trs for somebody who stands left of the model and above it."""

    azimuth_deg: float
    elevation_deg: float

    def project(self, p_trs: object) -> FloatArray:
        """Give the place on paper, shape (..., 2), of points (..., 3)."""
        a, e = np.radians([self.azimuth_deg, self.elevation_deg])
        right = [0.0, np.cos(a), np.sin(a)]
        up = [-np.cos(e), np.sin(a) * np.sin(e), -np.cos(a) * np.sin(e)]
        return np.asarray(p_trs, dtype=np.float64) @ np.array([right, up]).T


ROOM = View(azimuth_deg=38.0, elevation_deg=24.0)
PLATE = View(azimuth_deg=14.0, elevation_deg=26.0)


@dataclass(frozen=True, slots=True)
class Laboratory:
    """Where every frame is in trs while the camera stands at P_CAM_TRS_M."""

    rig: Rig
    trs_from: dict[str, RigidTransform]
    """``trs_from[name]`` is trs_from_name."""
    rail_m: float

    @property
    def spec(self) -> LaboratorySpec:
        """Get the laboratory as designed."""
        return self.rig.config.laboratory

    def origin(self, frame: str) -> FloatArray:
        """Give the origin of a frame in trs."""
        return self.trs_from[frame].translation


def read_laboratory() -> Laboratory:
    """Read rig and calibration record, and place every frame."""
    rig = load_rig(ROOT / "campaigns/rigs/twin.yaml")
    record = CalibrationRecord.load(ROOT / "calibration/records/twin.json")
    mounting = rig.config.laboratory.mounting
    trs_from_cam = pose_along_boresight(P_CAM_TRS_M, boresight=[0, 0, -1], right=[0, 1, 0])
    target = mounting.robot_target(trs_from_cam)
    trs_from_rail = mounting.trs_from_rail.pose
    trs_from_base = trs_from_rail * RigidTransform.from_translation([target.rail_m, 0.0, 0.0])
    trs_from_flange = trs_from_base * target.base_from_flange
    trs_from = {
        "trs": RigidTransform.identity(),
        "trk": record.trs_from_trk,
        "rail": trs_from_rail,
        "base": trs_from_base,
        "flange": trs_from_flange,
        "tmac": trs_from_flange * mounting.flange_from_tmac.pose,
        "cam": trs_from_cam,
        "blender_cam": trs_from_cam * CAM_FROM_BLENDER_CAM,
        "board": rig.config.laboratory.board.trs_from_board.pose,
    }
    return Laboratory(rig, trs_from, target.rail_m)


def draw(path: Path) -> None:
    """Draw the picture."""
    mpl.rcParams.update({"font.size": 11, "font.family": "DejaVu Sans"})
    laboratory = read_laboratory()
    figure = Figure(figsize=(17, 10), facecolor="white")
    room = figure.add_axes((0.01, 0.08, 0.61, 0.86))
    plate = figure.add_axes((0.64, 0.50, 0.35, 0.44))
    cameras = figure.add_axes((0.64, 0.08, 0.19, 0.36))
    pixels = figure.add_axes((0.85, 0.10, 0.13, 0.31))
    for axes in (room, plate, cameras, pixels):
        axes.set_aspect("equal")
        axes.axis("off")
    draw_room(room, laboratory)
    draw_plate(plate, laboratory)
    draw_camera_frames(cameras)
    draw_pixels(pixels)
    draw_legend(figure)
    figure.savefig(path, dpi=110)


def draw_room(axes: Axes, laboratory: Laboratory) -> None:
    """Draw the whole laboratory."""
    axes.set_title("The laboratory", fontsize=15, loc="left")
    draw_floor(axes, laboratory)
    draw_terrain(axes, laboratory)
    draw_field_of_view(axes, laboratory)
    draw_board(axes, laboratory)
    draw_robot(axes, laboratory)
    draw_lamp(axes, laboratory)
    draw_reflectors(axes, laboratory)
    for name, length_m in (("trs", 0.7), ("trk", 0.55), ("rail", 0.55), ("base", 0.45)):
        draw_triad(axes, ROOM, laboratory.trs_from[name], length_m=length_m)
    for name, length_m in (("board", 0.22), ("cam", 0.3)):
        draw_triad(axes, ROOM, laboratory.trs_from[name], length_m=length_m, width=1.6)
    label_room(axes, laboratory)
    draw_chain(axes, laboratory)
    axes.margins(0.02)


def draw_floor(axes: Axes, laboratory: Laboratory) -> None:
    """Draw the floor the rail and the tracker stand on."""
    x = laboratory.origin("rail")[0] + 0.02
    corners = [[x, -0.5, 0.0], [x, 5.4, 0.0], [x, 5.4, 6.5], [x, -0.5, 6.5]]
    axes.fill(*ROOM.project(corners).T, color="0.955", zorder=0)


def draw_terrain(axes: Axes, laboratory: Laboratory) -> None:
    """Draw the terrain model of the rig, shaded by its slope."""
    config = laboratory.rig.config.terrain.model_copy(update={"spacing_m": 0.01})
    heightmap = load_terrain(config, base_dir=laboratory.rig.path.parent)
    z = heightmap.height_m.astype(np.float64) + heightmap.origin_trs_m[2]
    x = heightmap.origin_trs_m[0] + np.linspace(0, heightmap.size_m[0], z.shape[0])
    y = heightmap.origin_trs_m[1] + np.linspace(0, heightmap.size_m[1], z.shape[1])
    points = np.stack([*np.meshgrid(x, y, indexing="ij"), z], axis=-1)
    slope_x, slope_y = np.gradient(z, 0.01)
    shade = 0.62 + 0.35 * np.tanh(1.2 * (slope_x + slope_y))
    u, v = np.moveaxis(ROOM.project(points), -1, 0)
    axes.pcolormesh(
        u, v, shade, cmap="gray", vmin=0, vmax=1, shading="gouraud", zorder=1, rasterized=True
    )


def draw_field_of_view(axes: Axes, laboratory: Laboratory) -> None:
    """Draw the pyramid the camera sees, down to the plane of the reflectors."""
    camera = laboratory.spec.camera.nominal_model
    right, bottom = camera.width_px - 0.5, camera.height_px - 0.5
    rays = camera.rays([[-0.5, -0.5], [right, -0.5], [right, bottom], [-0.5, bottom]])
    depth_m = P_CAM_TRS_M[2]
    p_cam = np.column_stack([rays, np.ones(4)]) * depth_m
    trs_from_cam = laboratory.trs_from["cam"]
    corners = ROOM.project(trs_from_cam.apply(p_cam))
    apex = ROOM.project(trs_from_cam.translation)
    axes.fill(*corners.T, facecolor="#ffb000", alpha=0.10, edgecolor="none", zorder=2)
    axes.plot(*np.vstack([corners, corners[:1]]).T, color="#e08a00", lw=1.3, zorder=2)
    for corner in corners:
        axes.plot(*np.stack([apex, corner]).T, color="#e08a00", lw=0.9, zorder=2)
    fov_deg = np.degrees(camera.horizontal_fov_rad)
    at = ROOM.project([2.45, 2.55, 0.95])
    axes.text(*at, f"field of view {fov_deg:.0f}°", color="#a86200", fontsize=10, zorder=9)


def draw_board(axes: Axes, laboratory: Laboratory) -> None:
    """Draw the calibration board, square by square."""
    spec, trs_from_board = laboratory.spec.board, laboratory.trs_from["board"]
    for row in range(spec.rows):
        for column in range(spec.columns):
            corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]) + [column, row, 0]
            p_trs = trs_from_board.apply(corners * spec.square_m)
            colour = "0.1" if (row + column) % 2 == 0 else "white"
            axes.fill(*ROOM.project(p_trs).T, color=colour, lw=0, zorder=3)


def draw_robot(axes: Axes, laboratory: Laboratory) -> None:
    """Draw rail, base, arm and the plate with camera and T-MAC."""
    rail, base, flange = (laboratory.origin(name) for name in ("rail", "base", "flange"))
    low_m, high_m = laboratory.spec.mounting.rail_range_m
    ends = laboratory.trs_from["rail"].apply([[low_m, 0, 0], [high_m, 0, 0]])
    for side_m in (-0.12, 0.12):
        axes.plot(*ROOM.project(ends + [0, side_m, 0]).T, color="0.55", lw=3, zorder=2)
    shoulder = [base[0] - 0.9, base[1], base[2] + 0.15]
    elbow = [flange[0] - 0.25, flange[1], (base[2] + flange[2]) / 2 + 0.1]
    arm = ROOM.project([base, shoulder, elbow, flange])
    axes.plot(*arm.T, color="#f4a460", lw=9, solid_capstyle="round", alpha=0.85, zorder=4)
    axes.plot(*arm[1:3].T, "o", color="#c9762b", ms=9, zorder=4)
    ends = ROOM.project([laboratory.origin("cam"), flange, laboratory.origin("tmac")])
    axes.plot(*ends.T, color="0.2", lw=4, solid_capstyle="round", zorder=5)
    start, end = ROOM.project([rail + [0, -0.45, 0], base + [0, -0.45, 0]])
    axes.annotate("", end, start, arrowprops={"arrowstyle": "->", "color": MUTED, "lw": 1.2})
    axes.text(*((start + end) / 2 + [-0.06, -0.12]), "rail_m", color=MUTED, ha="right", zorder=9)


def draw_lamp(axes: Axes, laboratory: Laboratory) -> None:
    """Draw the lamp, and the way its light goes to the model."""
    p_lamp, p_hit = ROOM.project([laboratory.spec.lamp.p_trs_m, [0.9, 1.0, 0.1]])
    towards = p_lamp + (p_hit - p_lamp) * 0.45
    arrow = {"arrowstyle": "->", "color": "#e0b000", "lw": 1.6, "ls": "--"}
    axes.annotate("", towards, p_lamp, arrowprops=arrow, zorder=3)
    axes.plot(*p_lamp, marker="*", ms=26, color="#ffcc00", mec="#a07800", zorder=6)


def draw_reflectors(axes: Axes, laboratory: Laboratory) -> None:
    """Draw the three reflectors that define trs, with the beams of the tracker."""
    beam = {"color": "#d62728", "lw": 0.7, "alpha": 0.55, "ls": (0, (6, 3))}
    tracker = ROOM.project(laboratory.origin("trk"))
    for name, p_trs in laboratory.spec.reflectors.points_m.items():
        place = ROOM.project(p_trs)
        axes.plot(*np.stack([tracker, place]).T, zorder=2.5, **beam)
        axes.plot(*place, "o", ms=10, color="white", mec="black", mew=2, zorder=7)
        shift, align = ((-0.1, 0.16), "right") if "left" in name else ((-0.1, 0.16), "left")
        axes.text(*(place + shift), f"reflector {name}", fontsize=9, ha=align, zorder=9)


def draw_triad(
    axes: Axes, view: View, trs_from_frame: RigidTransform, *, length_m: float, width: float = 2.4
) -> None:
    """Draw the axes of a frame: x red, y green, z blue."""
    origin = view.project(trs_from_frame.translation)
    for axis, colour, name in zip(np.eye(3), AXIS_COLOURS, "xyz", strict=True):
        tip = view.project(trs_from_frame.apply(axis * length_m))
        arrow = {"arrowstyle": "-|>", "color": colour, "lw": width, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", tip, origin, arrowprops=arrow, zorder=8)
        beyond = origin + (tip - origin) * 1.18
        axes.text(*beyond, name, color=colour, ha="center", va="center", fontsize=10, zorder=9)


def label(axes: Axes, at: FloatArray, name: str, what: str, *, align: str = "left") -> None:
    """Write the name of a frame in bold, and below it what it is."""
    box = {"boxstyle": "round,pad=0.15", "fc": "white", "ec": "none", "alpha": 0.75}
    axes.text(
        *at, name, fontweight="bold", fontsize=13, ha=align, va="bottom", zorder=10, bbox=box
    )
    axes.text(*at, what, fontsize=9.5, ha=align, va="top", zorder=10, bbox=box)


def label_room(axes: Axes, laboratory: Laboratory) -> None:
    """Name the frames of the room."""
    notes = (
        ("trs", "terrain model", (-0.25, -0.28), "right"),
        ("trk", "laser tracker", (0.3, -0.15), "left"),
        ("rail", "on the floor", (0.3, -0.45), "left"),
        ("base", "robot, on the rail", (0.45, -0.3), "left"),
        ("board", "calibration only", (-0.15, -0.15), "right"),
        ("cam", "camera, flange and T-MAC:\nsee the plate", (-0.3, -0.6), "right"),
    )
    for name, what, shift, align in notes:
        label(axes, ROOM.project(laboratory.origin(name)) + shift, name, what, align=align)
    lamp = ROOM.project(laboratory.spec.lamp.p_trs_m)
    label(axes, lamp + [0.3, 0.0], "lamp", "a point: only its place counts")


def draw_arrow(
    axes: Axes, start: FloatArray, end: FloatArray, *, bend: float, dashed: bool = False
) -> None:
    """Draw one link of the chain."""
    arrow = {
        "arrowstyle": "-|>,head_width=0.35,head_length=0.7",
        "connectionstyle": f"arc3,rad={bend}",
        "color": CHAIN,
        "lw": 2.2,
        "ls": "--" if dashed else "-",
        "shrinkA": 9,
        "shrinkB": 9,
    }
    axes.annotate("", end, start, arrowprops=arrow, zorder=6)


def draw_chain(axes: Axes, laboratory: Laboratory) -> None:
    """Draw how the pose of the camera follows from measured transforms."""
    trs, trk, cam, tmac = (
        ROOM.project(laboratory.origin(name)) for name in ("trs", "trk", "cam", "tmac")
    )
    text = {"color": CHAIN, "fontsize": 11.5, "fontweight": "bold", "zorder": 10}
    draw_arrow(axes, trs, trk, bend=-0.32)
    axes.text(*((trs + trk) / 2 + [0.2, 1.0]), "trs_from_trk", ha="center", **text)
    draw_arrow(axes, trk, tmac, bend=-0.25)
    axes.text(*((trk + tmac) / 2 + [0.25, -0.62]), "trk_from_tmac", ha="center", **text)
    draw_arrow(axes, trs, cam, bend=0.15, dashed=True)
    axes.text(*(trs + (cam - trs) * 0.3 + [0.1, -0.55]), "trs_from_cam", ha="center", **text)


def draw_plate(axes: Axes, laboratory: Laboratory) -> None:
    """Draw the plate on the flange, much enlarged."""
    axes.set_title("The plate on the flange, enlarged", fontsize=15, loc="left")
    cam, flange, tmac = (laboratory.origin(name) for name in ("cam", "flange", "tmac"))
    corners = [
        flange + [x, y, 0.0] for x, y in ((-0.05, -0.13), (-0.05, 0.13), (0.05, 0.13), (0.05, -0.13))
    ]
    axes.fill(*PLATE.project(corners).T, fc="0.9", ec="0.6", zorder=0)
    for foot, head in ((flange + cam * [0, 1, 0] - flange * [0, 1, 0], cam),
                       (flange + tmac * [0, 1, 0] - flange * [0, 1, 0], tmac)):
        axes.plot(*PLATE.project([foot, head]).T, color="0.6", lw=5, zorder=1)
    for name in ("cam", "flange", "tmac"):
        draw_triad(axes, PLATE, laboratory.trs_from[name], length_m=0.055)
    notes = (
        ("cam", "x right, y down, z forward,\nto the model", (-0.012, 0.03), "right"),
        ("flange", "end of the robot arm", (0.004, -0.085), "center"),
        ("tmac", "target of the tracker", (0.02, -0.012), "left"),
    )
    for name, what, shift, align in notes:
        label(axes, PLATE.project(laboratory.origin(name)) + shift, name, what, align=align)
    start, end = PLATE.project([tmac, cam])
    draw_arrow(axes, start, end, bend=0.4)
    text = {"color": CHAIN, "fontsize": 11.5, "fontweight": "bold"}
    axes.text(*((start + end) / 2 + [0.0, 0.075]), "tmac_from_cam", ha="center", **text)
    axes.margins(0.12)


def draw_camera_frames(axes: Axes) -> None:
    """Draw the camera frame and Blender's beside it."""
    axes.set_title("One camera, two frames", fontsize=15, loc="left")


def draw_pixels(axes: Axes) -> None:
    """Draw where pixel coordinates start."""
    axes.set_title("Pixels", fontsize=15, loc="left")


def draw_legend(figure: Figure) -> None:
    """Write the chain, and how arrows and colours are to be read."""


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs/images/frames.png")
