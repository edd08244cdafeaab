"""Draw ``docs/images/frames.png``: python docs/draw_frames.py [PICTURE.png].

Everything stands where the rig file ``campaigns/rigs/twin.yaml`` puts it; the tracker, which has no
designed place, where the calibration record of that rig found it.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patheffects import withStroke
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
SQUARE = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])


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
    target = mounting.nominal.robot_target(trs_from_cam)
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
    return Laboratory(rig, trs_from)


def draw(path: Path) -> None:
    """Draw the picture."""
    mpl.rcParams.update({"font.size": 11, "font.family": "DejaVu Sans"})
    laboratory = read_laboratory()
    figure = Figure(figsize=(17, 9), facecolor="white")
    room = figure.add_axes((0.01, 0.10, 0.63, 0.85))
    plate = figure.add_axes((0.64, 0.50, 0.35, 0.45))
    cameras = figure.add_axes((0.64, 0.02, 0.21, 0.39))
    pixels = figure.add_axes((0.87, 0.02, 0.12, 0.39))
    for axes in (room, plate, cameras, pixels):
        axes.set_aspect("equal")
        axes.set_anchor("NW")
        axes.axis("off")
    draw_room(room, laboratory)
    draw_plate(plate, laboratory)
    draw_camera_frames(cameras)
    draw_pixels(pixels)
    draw_legend(figure)
    figure.savefig(path, dpi=100)


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
    for name, length_m in (("board", 0.3), ("cam", 0.3)):
        draw_triad(axes, ROOM, laboratory.trs_from[name], length_m=length_m, width=1.6)
    label_room(axes, laboratory)
    draw_chain(axes, laboratory)
    axes.axis((-1.25, 8.3, -4.75, 1.75))


def draw_floor(axes: Axes, laboratory: Laboratory) -> None:
    """Draw the floor, and the tripod of the tracker on it."""
    x = laboratory.origin("rail")[0] + 0.02
    corners = [[x, -0.4, 0.0], [x, 5.1, 0.0], [x, 5.1, 6.3], [x, -0.4, 6.3]]
    axes.fill(*ROOM.project(corners).T, color="0.945", zorder=0)
    tracker = laboratory.origin("trk")
    feet = [
        [x, tracker[1] + dy, tracker[2] + dz] for dy, dz in ((-0.3, 0.2), (0.3, 0.2), (0, -0.3))
    ]
    for foot in feet:
        axes.plot(*ROOM.project([tracker, foot]).T, color="0.6", lw=3, zorder=2)


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
    at = ROOM.project([2.6, 0.55, 0.0]) + np.array([0.02, -0.28])
    write(axes, at, f"what the camera sees: {fov_deg:.0f}°", color="#a86200", fontsize=10)


def draw_board(axes: Axes, laboratory: Laboratory) -> None:
    """Draw the calibration board, square by square."""
    spec, trs_from_board = laboratory.spec.board, laboratory.trs_from["board"]
    for row in range(spec.rows):
        for column in range(spec.columns):
            corners = np.pad(SQUARE, ((0, 0), (0, 1))) + np.array([column, row, 0])
            p_trs = trs_from_board.apply(corners * spec.square_m)
            colour = "0.1" if (row + column) % 2 == 0 else "white"
            axes.fill(*ROOM.project(p_trs).T, color=colour, lw=0, zorder=3)


def draw_robot(axes: Axes, laboratory: Laboratory) -> None:
    """Draw rail, base, arm and the plate with camera and T-MAC."""
    rail, base, flange = (laboratory.origin(name) for name in ("rail", "base", "flange"))
    low_m, high_m = laboratory.spec.mounting.rail_range_m
    ends = laboratory.trs_from["rail"].apply([[low_m, 0, 0], [high_m, 0, 0]])
    for side_m in (-0.12, 0.12):
        axes.plot(*ROOM.project(ends + np.array([0, side_m, 0])).T, color="0.55", lw=3, zorder=2)
    shoulder = [base[0] - 0.9, base[1], base[2] + 0.15]
    elbow = [flange[0] - 0.25, flange[1], (base[2] + flange[2]) / 2 + 0.1]
    arm = ROOM.project([base, shoulder, elbow, flange])
    axes.plot(*arm.T, color="#f4a460", lw=9, solid_capstyle="round", alpha=0.85, zorder=4)
    axes.plot(*arm[1:3].T, "o", color="#c9762b", ms=9, zorder=4)
    ends = ROOM.project([laboratory.origin("cam"), flange, laboratory.origin("tmac")])
    axes.plot(*ends.T, color="0.2", lw=4, solid_capstyle="round", zorder=5)
    start, end = ROOM.project(np.array([rail, base]) + np.array([0, -0.45, 0]))
    point(axes, start, end, arrowstyle="->", color=MUTED, lw=1.2)
    write(axes, (start + end) / 2 - np.array([0.06, 0.12]), "rail_m", color=MUTED, ha="right")


def draw_lamp(axes: Axes, laboratory: Laboratory) -> None:
    """Draw the lamp, and the way its light goes to the model."""
    p_lamp, p_hit = ROOM.project([laboratory.spec.lamp.p_trs_m, [0.9, 1.0, 0.1]])
    towards = p_lamp + (p_hit - p_lamp) * 0.45
    point(axes, p_lamp, towards, arrowstyle="->", color="#e0b000", lw=1.6, ls="--")
    axes.plot(*p_lamp, marker="*", ms=26, color="#ffcc00", mec="#a07800", zorder=6)


def draw_reflectors(axes: Axes, laboratory: Laboratory) -> None:
    """Draw the three reflectors that define trs, with the beams of the tracker."""
    tracker = ROOM.project(laboratory.origin("trk"))
    for name, p_trs in laboratory.spec.reflectors.points_m.items():
        place = ROOM.project(p_trs)
        beam = np.stack([tracker, place]).T
        axes.plot(*beam, color="#d62728", lw=0.7, alpha=0.55, ls=(0, (6, 3)), zorder=2.5)
        axes.plot(*place, "o", ms=10, color="white", mec="black", mew=2, zorder=7)
        shift, align = ((-0.12, 0.0), "right") if "left" in name else ((0.14, 0.02), "left")
        text = f"reflector\n{name}"
        write(axes, place + shift, text, fontsize=9.5, ha=align, va="center")


def draw_triad(
    axes: Axes, view: View, trs_from_frame: RigidTransform, *, length_m: float, width: float = 2.4
) -> None:
    """Draw the axes of a frame: x red, y green, z blue."""
    origin = view.project(trs_from_frame.translation)
    tips = view.project(trs_from_frame.apply(np.eye(3) * length_m))
    draw_axes(axes, origin, tips, names="xyz", width=width)


def draw_axes(
    axes: Axes, origin: FloatArray, tips: FloatArray, *, names: str, width: float = 2.4
) -> None:
    """Draw named and coloured arrows from one place on paper, shape (2,), to others (n, 2)."""
    for tip, name, colour in zip(tips, names, AXIS_COLOURS, strict=False):
        point(axes, origin, tip, color=colour, lw=width)
        beyond = origin + (tip - origin) * 1.18
        write(axes, beyond, name, color=colour, ha="center", va="center")


def write(axes: Axes, at: FloatArray, text: str, **style: Any) -> None:
    """Write text at a place (2,) on paper, with a white rim."""
    written = axes.text(float(at[0]), float(at[1]), text, zorder=10, **style)
    written.set_path_effects([withStroke(linewidth=2.5, foreground="white")])


def point(axes: Axes, start: FloatArray, end: FloatArray, **style: Any) -> None:
    """Draw an arrow from one place (2,) on paper to another."""
    straight = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0}
    tail, head = ((float(place[0]), float(place[1])) for place in (start, end))
    axes.annotate("", head, tail, arrowprops={**straight, **style}, zorder=8)


def label(axes: Axes, at: FloatArray, name: str, what: str, *, align: str = "left") -> None:
    """Write the name of a frame in bold, and below it what it is."""
    write(axes, at, what, fontsize=9.5, ha=align, va="top")
    write(axes, at, name, fontweight="bold", fontsize=13, ha=align, va="bottom")


def label_room(axes: Axes, laboratory: Laboratory) -> None:
    """Name the frames of the room."""
    notes = (
        ("trs", "terrain model", (-0.2, -0.52), "right"),
        ("trk", "laser tracker", (0.3, -0.15), "left"),
        ("rail", "on the floor, runs to the model", (0.3, 0.0), "left"),
        ("base", "foot of the robot,\nmoves on the rail", (0.32, 0.2), "left"),
        ("board", "only for\ncalibration", (0.52, -0.02), "left"),
        ("cam", "flange and tmac:\nsee at right", (0.37, 0.53), "left"),
    )
    for name, what, shift, align in notes:
        label(axes, ROOM.project(laboratory.origin(name)) + shift, name, what, align=align)
    lamp = ROOM.project(laboratory.spec.lamp.p_trs_m) - np.array([0.22, 0.0])
    label(axes, lamp, "lamp", "a point: only\nits place counts", align="right")


def draw_arrow(
    axes: Axes, start: FloatArray, end: FloatArray, *, bend: float, dashed: bool = False
) -> None:
    """Draw one link of the chain."""
    style = {"arrowstyle": "-|>,head_width=0.35,head_length=0.7", "color": CHAIN, "lw": 2.2}
    ends = {"shrinkA": 9, "shrinkB": 9, "ls": "--" if dashed else "-"}
    point(axes, start, end, connectionstyle=f"arc3,rad={bend}", **style, **ends)


def name_link(axes: Axes, at: FloatArray, name: str) -> None:
    """Write the name of a link of the chain."""
    write(axes, at, name, color=CHAIN, fontsize=11.5, fontweight="bold", ha="center")


def draw_chain(axes: Axes, laboratory: Laboratory) -> None:
    """Draw how the pose of the camera follows from measured transforms."""
    trs, trk, cam, tmac = (
        ROOM.project(laboratory.origin(name)) for name in ("trs", "trk", "cam", "tmac")
    )
    draw_arrow(axes, trs, trk, bend=-0.42)
    name_link(axes, (trs + trk) / 2 + np.array([2.25, 0.86]), "trs_from_trk")
    draw_arrow(axes, trk, tmac, bend=-0.25)
    name_link(axes, (trk + tmac) / 2 + np.array([0.23, -0.52]), "trk_from_tmac")
    draw_arrow(axes, trs, cam, bend=0.15, dashed=True)
    name_link(axes, trs + (cam - trs) * 0.3 + np.array([0.0, -0.65]), "trs_from_cam")


def draw_plate(axes: Axes, laboratory: Laboratory) -> None:
    """Draw the plate on the flange, much enlarged."""
    axes.set_title("The plate on the flange, enlarged", fontsize=15, loc="left")
    cam, flange, tmac = (laboratory.origin(name) for name in ("cam", "flange", "tmac"))
    sides_m = ((-0.05, -0.13), (-0.05, 0.13), (0.05, 0.13), (0.05, -0.13))
    corners = [flange + np.array([x, y, 0.0]) for x, y in sides_m]
    axes.fill(*PLATE.project(corners).T, fc="0.9", ec="0.6", zorder=0)
    for head in (cam, tmac):
        foot = [head[0], head[1], flange[2]]
        axes.plot(*PLATE.project([foot, head]).T, color="0.6", lw=5, zorder=1)
    for name in ("cam", "flange", "tmac"):
        draw_triad(axes, PLATE, laboratory.trs_from[name], length_m=0.055)
    notes = (
        ("cam", "camera", (-0.012, -0.012), "right"),
        ("flange", "end of the robot arm", (0.004, -0.085), "center"),
        ("tmac", "target of\nthe tracker", (0.03, 0.0), "left"),
    )
    for name, what, shift, align in notes:
        label(axes, PLATE.project(laboratory.origin(name)) + shift, name, what, align=align)
    start, end = PLATE.project([tmac, cam])
    draw_arrow(axes, start, end, bend=0.4)
    name_link(axes, (start + end) / 2 + np.array([0.0, 0.052]), "tmac_from_cam")
    axes.set_xlim(*(PLATE.project(flange)[0] + [-0.18, 0.18]))
    axes.set_ylim(*(PLATE.project(flange)[1] + [-0.1, 0.13]))


def draw_camera_frames(axes: Axes) -> None:
    """Draw the camera frame and Blender's beside it, as seen from behind the camera."""
    axes.set_title("One camera, two frames", fontsize=15, loc="left")
    frames = (
        ("cam", RigidTransform.identity(), 0.0, "z looks forward"),
        ("blender_cam", CAM_FROM_BLENDER_CAM, 3.4, "z looks backward"),
    )
    for name, cam_from_frame, shift, what in frames:
        draw_camera(axes, cam_from_frame, shift=shift)
        label(axes, np.array([shift + 0.35, -1.95]), name, what, align="center")
    text = "the same place and the same image;\ny and z are reversed"
    axes.text(2.05, -2.8, text, ha="center", va="top", fontsize=10, color="0.25")
    axes.axis((-1.2, 5.3, -3.5, 2.2))


def draw_camera(axes: Axes, cam_from_frame: RigidTransform, *, shift: float) -> None:
    """Draw a camera with a frame at its centre; forward is up to the right on paper."""
    on_paper = np.array([[1.0, 0.0], [0.0, -1.0], [0.62, 0.5]])
    image = np.array([[-0.8, -0.6, 1.7], [0.8, -0.6, 1.7], [0.8, 0.6, 1.7], [-0.8, 0.6, 1.7]])
    centre = np.array([shift, 0.0])
    corners = image @ on_paper + centre
    axes.fill(*corners.T, fc="#fff1d6", ec="#e08a00", lw=1.2, zorder=1)
    for corner in corners:
        axes.plot(*np.stack([centre, corner]).T, color="#e08a00", lw=0.8, zorder=1)
    tips = centre + 1.1 * cam_from_frame.rotation.as_matrix().T @ on_paper
    draw_axes(axes, centre, tips, names="xyz")


def draw_pixels(axes: Axes) -> None:
    """Draw where pixel coordinates start."""
    axes.set_title("Pixels", fontsize=15, loc="left")
    for row in range(3):
        for column in range(3):
            square = SQUARE + np.array([column, row]) - 0.5
            axes.fill(*square.T, fc="white" if row + column else "#e6ecff", ec="0.5")
            axes.plot(column, row, "o", ms=3, color="0.5")
    draw_axes(axes, np.zeros(2), np.array([[2.75, 0.0], [0.0, 2.75]]), names="uv")
    axes.plot(0, 0, "o", ms=7, color="black")
    axes.text(0.06, -0.2, "(0, 0)", fontsize=9, va="center", zorder=10)
    text = "(0, 0) is the centre of\nthe top-left pixel, its\ncorner (-0.5, -0.5)"
    axes.text(-0.5, 3.6, text, fontsize=10, va="top", color="0.25")
    axes.axis((-0.6, 3.3, 4.6, -0.6))


def draw_legend(figure: Figure) -> None:
    """Write the chain, and how arrows and colours are to be read."""
    chain = "trs_from_cam  =  trs_from_trk  *  trk_from_tmac  *  tmac_from_cam"
    figure.text(0.02, 0.075, chain, color=CHAIN, fontsize=16, fontweight="bold")
    how = (
        "The arrow of a_from_b runs from a to b; p_a = a_from_b.apply(p_b).     Axes: x red,"
        " y green, z blue.     Places: campaigns/rigs/twin.yaml, trk by calibration"
    )
    figure.text(0.02, 0.035, how, color="0.25", fontsize=11)


if __name__ == "__main__":
    draw(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs/images/frames.png")
