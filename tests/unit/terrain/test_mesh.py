import numpy as np
import pytest

from tronlab.terrain.formats import mesh
from tronlab.terrain.heightmap import HeightMap, TerrainError
from tronlab.terrain.raster import write_mesh


@pytest.fixture
def bumpy():
    height = np.random.default_rng(2).standard_normal((23, 17)).astype(np.float32)
    return HeightMap(height, 0.01, np.array([-0.02, 0.03, -0.13]))


@pytest.fixture(autouse=True)
def small_bands(monkeypatch):
    monkeypatch.setattr(mesh, "_NODES_AT_ONCE", 60)


def write(height_map, path, **settings):
    write_mesh(height_map, path, announce=lambda _: None, **settings)
    return READERS[path.suffix](path)


def read_ply(path):
    """Give the corners of all triangles, shape (n, 3, 3)."""
    header, _, body = path.read_bytes().partition(b"end_header\n")
    words = header.decode("ascii").split()
    n_nodes, n_faces = (int(words[words.index(kind) + 1]) for kind in ("vertex", "face"))
    assert "binary_little_endian" in words
    nodes = np.frombuffer(body, "<f4", 3 * n_nodes).reshape(-1, 3)
    faces = np.frombuffer(body, [("n", "u1"), ("i", "<u4", 3)], offset=12 * n_nodes)
    assert len(faces) == n_faces
    assert set(faces["n"]) == {3}
    return nodes[faces["i"]]


def read_stl(path):
    data = path.read_bytes()
    triangles = np.frombuffer(data, [("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")], -1, 84)
    assert len(triangles) == int.from_bytes(data[80:84], "little")
    corners = triangles["c"]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(triangles["n"], normal, atol=1e-3)
    return corners


def read_obj(path):
    lines = [line.split() for line in path.read_text().splitlines() if line[0] in "vf"]
    nodes = np.array([line[1:] for line in lines if line[0] == "v"], dtype=float)
    faces = np.array([line[1:] for line in lines if line[0] == "f"], dtype=int)
    return nodes[faces - 1]


READERS = {".ply": read_ply, ".stl": read_stl, ".obj": read_obj}


@pytest.mark.parametrize("suffix", READERS)
@pytest.mark.parametrize("every_n", [1, 3])
def test_the_triangles_are_the_renderers(tmp_path, bumpy, suffix, every_n):
    triangles = write(bumpy, tmp_path / f"model{suffix}", every_n=every_n)
    step_m = every_n * bumpy.spacing_m
    index = (triangles - bumpy.origin_trs_m)[..., :2] / step_m
    nodes = np.rint(index).astype(int)
    np.testing.assert_allclose(index, nodes, atol=1e-4)
    height = bumpy.height_m[::every_n, ::every_n][nodes[..., 0], nodes[..., 1]]
    np.testing.assert_allclose(triangles[..., 2], height - 0.13, atol=1e-6)
    # Each cell once below and once above the edge from its node (i, j) to (i + 1, j + 1).
    corner = nodes.min(axis=1)
    shape = [len(range(0, n, every_n)) - 1 for n in bumpy.height_m.shape]
    cells = [(i, j) for i in range(shape[0]) for j in range(shape[1])]
    offsets = [sorted(map(tuple, triangle)) for triangle in (nodes - corner[:, None]).tolist()]
    found = sorted(zip(map(tuple, corner.tolist()), offsets, strict=True))
    lower, upper = [(0, 0), (1, 0), (1, 1)], [(0, 0), (0, 1), (1, 1)]
    assert found == sorted((cell, half) for cell in cells for half in (lower, upper))


@pytest.mark.parametrize("suffix", READERS)
def test_normals_point_up(tmp_path, bumpy, suffix):
    triangles = write(bumpy, tmp_path / f"model{suffix}")
    sides = triangles[:, 1:, :2] - triangles[:, :1, :2]
    assert (sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0] > 0).all()


def test_progress_ends_at_the_end(tmp_path, bumpy):
    told = []
    write(bumpy, tmp_path / "model.ply", on_progress=lambda done, n: told.append((done, n)))
    assert told == sorted(told)
    assert told[-1] == (46, 46)


def test_an_interrupted_mesh_leaves_nothing(tmp_path, bumpy):
    def interrupt(done, n):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write(bumpy, tmp_path / "model.stl", on_progress=interrupt)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("name", "every_n", "message"),
    [
        ("model.blend", 1, r"cannot be written \(allowed: \.ply, \.stl, \.obj\)"),
        ("model.ply", 0, "every_n is 0, must be 1 or more"),
        ("model.ply", 20, "every 20-th node of 23 x 17 leaves 2 x 1, a mesh needs 2 x 2"),
        ("nowhere/model.obj", 1, "cannot be written: No such file or directory"),
    ],
)
def test_a_mesh_that_cannot_be_written(tmp_path, bumpy, name, every_n, message):
    with pytest.raises(TerrainError, match=message):
        write(bumpy, tmp_path / name, every_n=every_n)
    assert list(tmp_path.iterdir()) == []


def test_more_triangles_than_32_bits_count(tmp_path):
    height = np.broadcast_to(np.float32(0), (50_000, 50_000))
    flat = object.__new__(HeightMap)
    object.__setattr__(flat, "height_m", height)
    with pytest.raises(TerrainError, match="4999800002 triangles are more than the format can"):
        write_mesh(flat, tmp_path / "model.stl", announce=lambda _: None)
