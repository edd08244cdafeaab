"""Write six shots over a textured surface: ``make_textured_dataset.py PATH``."""

import sys
from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from tronlab.dataset.records import ReferenceView
from tronlab.dataset.writer import DatasetWriter

TESTS = Path(__file__).parents[2]


def load(name: str, path: Path) -> ModuleType:
    spec = spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def write(path: Path) -> None:
    fakes = load("fakes", TESTS / "conftest.py")
    scenes = load("scenes", TESTS / "unit" / "nav" / "conftest.py")
    scene, camera = scenes.Scene(), scenes.CAMERA

    def pose(z_m: float, turn_rad: float = 0.0) -> RigidTransform:
        turn = Rotation.from_rotvec([0.01, -0.02, turn_rad])
        return RigidTransform.from_components([0.02, 0.01, z_m], turn * scenes.LOOKING_DOWN)

    def view(i: int, z_m: float) -> ReferenceView:
        grey, depth = scene.see(pose(z_m))
        image, mask = np.rint(grey).astype(np.uint8), np.isfinite(depth)
        return ReferenceView(i, pose(z_m), image, depth.astype(np.float32), mask)

    provenance = replace(fakes.fake_provenance(6), camera=camera)
    with DatasetWriter(path, provenance) as writer:
        writer.add_references([view(i, z_m) for i, z_m in enumerate((2.2, 1.8))])
        for i in range(6):
            trs_from_cam = pose(2.2 - 0.08 * i, 0.1 * i)
            grey, depth = scene.see(trs_from_cam)
            shot = fakes.fake_shot(i, trs_from_cam=trs_from_cam)
            mask = np.isfinite(depth)
            truth = replace(
                shot.truth, range_los_m=2.2 - 0.08 * i, usable_fraction=float(mask.mean())
            )
            frame = replace(shot.frame, image=np.rint(grey).astype(np.uint8))
            writer.commit(replace(shot, frame=frame, mask=mask, truth=truth))
        writer.finish("complete")


if __name__ == "__main__":
    write(Path(sys.argv[1]))
