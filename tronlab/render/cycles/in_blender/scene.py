# pyright: basic, reportMissingImports=false
"""Renders a height map with Cycles: a script for Blender's own Python (``pip install bpy``).

``tronlab.render.cycles.process`` starts it with a folder for files and then sends requests, one
JSON object a line. Each is answered by one line: the result, or ``{"error": ...}``. Arrays go
through files of the folder. When the pipe closes the script removes the folder and ends, even in
the middle of a rendering.

It runs without tronlab: beside Blender's modules it may import numpy and the standard library only.
"""

import json
import os
import queue
import shutil
import sys
import threading
import traceback
from contextlib import suppress
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Quaternion, Vector

NEEDED_VERSION = (5, 0)
SENSOR_MM = 36.0
REACH_M = (1e-4, 1e6)
NO_SURFACE_M = 1e9
"""Cycles gives a depth of 1e10 where a ray meets nothing."""
LEAST_ALBEDO = 1e-6
"""Blacker surfaces would not tell lit from unlit."""
SURFACE = "surface"
"""Texture and pass of the same name: slopes along X and Y, and albedo; in the pass all 0 where the
terrain is seen from below."""
FACET = "facet"
"""Pass: unit normal of the triangle, on the side that is seen."""


def main(folder: Path) -> None:
    """Answer requests until the pipe closes."""
    replies = _private_stdout()
    requests = _requests_until_closed(folder)
    scene = TerrainScene(folder)
    _reply(replies, {"blender": bpy.app.version_string})
    while True:
        request = json.loads(requests.get())
        try:
            answer = getattr(scene, f"do_{request.pop('do')}")(**request)
        except Exception as error:  # the parent is told, and decides
            traceback.print_exc()
            answer = {"error": f"{type(error).__name__}: {error}"}
        _reply(replies, answer or {})


def _private_stdout():
    """Keep the standard output for replies: what Blender prints goes to the standard error."""
    replies = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    return replies


def _reply(replies, answer: dict) -> None:
    # Without the parent there is nobody to answer: the thread that reads is about to end us.
    with suppress(BrokenPipeError):
        replies.write(json.dumps(answer) + "\n")
        replies.flush()


def _requests_until_closed(folder: Path) -> "queue.Queue[str]":
    """Read requests in a thread, so that the end of the parent ends a rendering too."""
    requests: queue.Queue[str] = queue.Queue()

    def read() -> None:
        for line in sys.stdin:
            requests.put(line)
        shutil.rmtree(folder, ignore_errors=True)
        os._exit(0)

    threading.Thread(target=read, daemon=True).start()
    return requests


class TerrainScene:
    """A height map, a lamp and a camera; stays as it is between renderings."""

    def __init__(self, folder: Path) -> None:
        if bpy.app.version[:2] < NEEDED_VERSION:
            raise SystemExit(f"Blender is {bpy.app.version_string}, must be 5.0 or later")
        self._folder = folder
        import addon_utils  # bpy brings it along

        bpy.ops.wm.read_factory_settings(use_empty=True)
        addon_utils.enable("cycles")
        self._scene = bpy.context.scene
        self._set_up_rendering()
        self._set_up_passes()
        self._scene.world = _black_world()
        self._lamp = self._linked("lamp", bpy.data.lights.new("lamp", "POINT"))
        self._lamp.visible_camera = False
        self._camera = self._linked("camera", bpy.data.cameras.new("camera"))
        self._scene.camera = self._camera

    def do_terrain(self, heights: str, albedo: str | None, spacing_m: float, origin_m: list[float]):
        """Build the terrain from files of the folder: heights, and albedo from 0 to 65535."""
        height = np.load(self._folder / heights)
        share = 1.0 if albedo is None else np.load(self._folder / albedo) / np.float32(65535)
        mesh = _mesh(height, spacing_m, origin_m)
        texture = _surface_texture(height, share, spacing_m)
        mesh.materials.append(_matte_material(texture, spacing_m, origin_m))
        terrain = self._linked("terrain", mesh)
        # Their defaults move shadow rays and light of smoothly shaded triangles.
        terrain.cycles.shadow_terminator_offset = 0.0
        terrain.cycles.shadow_terminator_geometry_offset = 0.0

    def do_render(
        self,
        *,
        poses: str,
        i_pose: int,
        camera: dict,
        lamp: dict,
        n_samples: int,
        over_area: bool,
        image: str,
    ):
        """Render from pose number ``i_pose`` of a text file, and write a file of arrays."""
        self._camera.matrix_world = read_poses(self._folder / poses)[i_pose]
        self._set_camera(**camera)
        self._set_lamp(**lamp)
        self._scene.cycles.samples = n_samples
        # The box is always one pixel wide: samples of its area.
        self._scene.cycles.pixel_filter_type = "BOX" if over_area else "GAUSSIAN"
        exr = self._folder / "render.exr"
        self._scene.render.filepath = str(exr)
        bpy.ops.render.render(write_still=True)
        np.savez(self._folder / image, **_arrays(_passes(exr)))
        exr.unlink()

    def _linked(self, name: str, data):
        thing = bpy.data.objects.new(name, data)
        self._scene.collection.objects.link(thing)
        return thing

    def _set_up_rendering(self) -> None:
        render, cycles = self._scene.render, self._scene.cycles
        render.engine = "CYCLES"
        render.resolution_percentage = 100
        render.use_persistent_data = True
        render.use_compositing = render.use_sequencer = False
        self._scene.view_settings.view_transform = "Raw"
        output = render.image_settings
        output.media_type = "MULTI_LAYER_IMAGE"
        output.file_format = "OPEN_EXR_MULTILAYER"
        output.color_depth = "32"
        output.exr_codec = "NONE"
        output.use_exr_interleave = True
        cycles.device = "CPU"
        cycles.max_bounces = 0
        cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_auto_tile = False
        # With the light tree and the threshold a dim light is sampled only now and then.
        cycles.use_light_tree = False
        cycles.light_sampling_threshold = 0.0
        # The narrowest of the other filters: all samples through the pixel's centre, as depth is.
        cycles.filter_width = 0.01

    def _set_up_passes(self) -> None:
        layer = self._scene.view_layers[0]
        layer.use_pass_z = True
        for name in (SURFACE, FACET):
            aov = layer.aovs.add()
            aov.name, aov.type = name, "COLOR"

    def _set_camera(
        self,
        *,
        width_px: int,
        height_px: int,
        fx_px: float,
        fy_px: float,
        cx_px: float,
        cy_px: float,
    ) -> None:
        """Set a pinhole camera whose (0, 0) is the centre of the top left pixel."""
        render, camera = self._scene.render, self._camera.data
        render.resolution_x, render.resolution_y = width_px, height_px
        # Blender scales whichever axis has the larger factor; neither may be below 1.
        render.pixel_aspect_x, render.pixel_aspect_y = max(fy_px / fx_px, 1), max(fx_px / fy_px, 1)
        camera.sensor_fit = "HORIZONTAL"
        camera.sensor_width = SENSOR_MM
        camera.lens = fx_px / width_px * SENSOR_MM
        camera.shift_x = ((width_px - 1) / 2 - cx_px) / width_px
        camera.shift_y = (cy_px - (height_px - 1) / 2) / width_px * fx_px / fy_px
        camera.clip_start, camera.clip_end = REACH_M

    def _set_lamp(self, *, p_trs_m: list[float], radius_m: float) -> None:
        """Set a lamp under which a white surface facing it at 1 m has a radiance of 1."""
        self._lamp.location = p_trs_m
        light = self._lamp.data
        # The radiant flux of a radiant intensity of pi.
        light.energy = 4.0 * np.pi**2
        light.shadow_soft_size = radius_m
        light.use_soft_falloff = False


def read_poses(path: Path) -> "list[Matrix]":
    """Read camera coordinates and Blender quaternion (w first) of each line; see pose_file.py."""
    lines = (line.split("#")[0].split() for line in path.read_text(encoding="utf-8").splitlines())
    poses = []
    for values in lines:
        if values:
            numbers = [float(value) for value in values]
            place = Vector(numbers[:3])
            poses.append(Matrix.LocRotScale(place, Quaternion(numbers[3:]), None))
    return poses


def _mesh(height, spacing_m: float, origin_m: list[float]):
    """Make two triangles a cell, which share the edge from node (i, j) to (i + 1, j + 1)."""
    rows, columns = height.shape
    places = np.empty((rows, columns, 3), dtype=np.float32)
    places[..., 0] = (origin_m[0] + np.arange(rows) * spacing_m)[:, None]
    places[..., 1] = origin_m[1] + np.arange(columns) * spacing_m
    places[..., 2] = origin_m[2] + height.astype(np.float64)
    node = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:]
    corners = np.stack([a, b, c, a, c, d], axis=-1).ravel()
    mesh = bpy.data.meshes.new("terrain")
    mesh.vertices.add(places.size // 3)
    mesh.vertices.foreach_set("co", places.ravel())
    mesh.loops.add(corners.size)
    mesh.loops.foreach_set("vertex_index", corners)
    mesh.polygons.add(corners.size // 3)
    mesh.polygons.foreach_set("loop_start", np.arange(0, corners.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    mesh.shade_flat()  # the material brings its own normals
    return mesh


def _surface_texture(height, albedo, spacing_m: float):
    """Make an image of slopes and albedo: width along X, height along Y, a pixel a node."""
    rows, columns = height.shape
    surface = np.ones((columns, rows, 4), dtype=np.float32)
    slope_x, slope_y = np.gradient(height, np.float32(spacing_m))
    surface[..., 0], surface[..., 1] = slope_x.T, slope_y.T
    surface[..., 2] = np.maximum(albedo, LEAST_ALBEDO).T
    texture = bpy.data.images.new(SURFACE, rows, columns, float_buffer=True, is_data=True)
    texture.alpha_mode = "NONE"
    texture.pixels.foreach_set(surface.ravel())
    return texture


def _matte_material(texture, spacing_m: float, origin_m: list[float]):
    """Make a Lambert surface with the normals and the albedo of a texture.

    Between the nodes the texture is interpolated bilinearly: so are our slopes. The mesh's normals
    would be interpolated in its triangles.
    """
    material = bpy.data.materials.new("matte")
    material.cycles.use_bump_map_correction = False
    tree = material.node_tree
    tree.nodes.clear()

    def node(kind: str, **properties):
        made = tree.nodes.new(f"ShaderNode{kind}")
        for name, value in properties.items():
            setattr(made, name, value)
        return made

    geometry = node("NewGeometry")
    texel = node("VectorMath", operation="MULTIPLY_ADD")
    texel.inputs[1].default_value = (*(1 / (spacing_m * n) for n in texture.size), 0)
    texel.inputs[2].default_value = (
        (0.5 - origin_m[0] / spacing_m) / texture.size[0],
        (0.5 - origin_m[1] / spacing_m) / texture.size[1],
        0,
    )
    image = node("TexImage", image=texture, interpolation="Linear", extension="EXTEND")
    is_upper = node("Math", operation="SUBTRACT")
    is_upper.inputs[0].default_value = 1.0
    surface = node("VectorMath", operation="SCALE")
    components = node("SeparateXYZ")
    upward = node("VectorMath", operation="MULTIPLY_ADD")
    upward.inputs[1].default_value, upward.inputs[2].default_value = (-1, -1, 0), (0, 0, 1)
    normal = node("VectorMath", operation="NORMALIZE")
    matte = node("BsdfDiffuse")
    matte.inputs["Roughness"].default_value = 0.0
    surface_pass = node("OutputAOV", aov_name=SURFACE)
    facet_pass = node("OutputAOV", aov_name=FACET)
    output = node("OutputMaterial")
    for source, target in (
        (geometry.outputs["Backfacing"], is_upper.inputs[1]),
        (geometry.outputs["Position"], texel.inputs[0]),
        (texel.outputs[0], image.inputs["Vector"]),
        (image.outputs["Color"], surface.inputs[0]),
        (is_upper.outputs[0], surface.inputs["Scale"]),
        (surface.outputs[0], components.inputs[0]),
        (surface.outputs[0], upward.inputs[0]),
        (upward.outputs[0], normal.inputs[0]),
        (normal.outputs[0], matte.inputs["Normal"]),
        (components.outputs[2], matte.inputs["Color"]),
        (surface.outputs[0], surface_pass.inputs["Color"]),
        (geometry.outputs["True Normal"], facet_pass.inputs["Color"]),
        (matte.outputs[0], output.inputs["Surface"]),
    ):
        tree.links.new(source, target)
    return material


def _black_world():
    world = bpy.data.worlds.new("black")
    world.cycles.sampling_method = "NONE"
    background = world.node_tree.nodes["Background"]
    background.inputs["Strength"].default_value = 0.0
    return world


def _passes(exr: Path) -> "dict[str, np.ndarray]":
    """Read the passes of a rendering, each of shape (rows, columns, components)."""
    image_io = _open_image_io()
    image = image_io.ImageBuf(str(exr))
    pixels = image.get_pixels(image_io.FLOAT)
    passes: dict[str, list[int]] = {}
    for index, channel in enumerate(image.spec().channelnames):
        passes.setdefault(channel.split(".")[-2], []).append(index)
    return {name: pixels[..., indices] for name, indices in passes.items()}


def _open_image_io():
    """Import OpenImageIO, which comes with Blender in a folder that bpy does not search."""
    python = f"python{sys.version_info.major}.{sys.version_info.minor}"
    modules = Path(bpy.utils.resource_path("LOCAL"), "python", "lib", python, "site-packages")
    if str(modules) not in sys.path:
        sys.path.append(str(modules))
    import OpenImageIO

    return OpenImageIO


def _arrays(passes: "dict[str, np.ndarray]") -> dict:
    depth, facet = passes["Depth"][..., 0], passes[FACET][..., :3]
    is_seen = (depth < NO_SURFACE_M) & (facet[..., 2] > 0)
    return {
        "radiance": passes["Combined"][..., 0],
        "depth_m": np.where(is_seen, depth, np.float32(np.nan)),
        "facet_normal": facet,
        "slope": passes[SURFACE][..., :2],
        "albedo": passes[SURFACE][..., 2],
    }


if __name__ == "__main__":
    main(Path(sys.argv[1]))
