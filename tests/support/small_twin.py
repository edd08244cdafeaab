"""The twin with a quarter of the pixels and no terrain, for tests that calibrate it."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from tronlab.calib.wizard import Bench, Settings
from tronlab.campaign.rig import load_rig
from tronlab.devices.laboratory import LaboratorySpec
from tronlab.devices.registry import KINDS, DeviceContext, Devices, make_device
from tronlab.geometry.camera import CameraModel
from tronlab.render.renderer import Rendering
from tronlab.terrain.heightmap import HeightMap
from tronlab.twin.config import WorldConfig
from tronlab.twin.devices import WORLD_KEY
from tronlab.twin.world import World, WorldSetup

TWIN_YAML = Path(__file__).resolve().parents[2] / "campaigns/rigs/twin.yaml"


class DarkTerrain:
    """Seen behind the board: a dark grey, everywhere."""

    def render(self, camera: CameraModel, *_: Any, **__: Any) -> Rendering:
        return Rendering(
            radiance=np.full(camera.shape, 0.02, np.float32),
            depth_m=np.ones(camera.shape, np.float32),
            points_trs_m=np.zeros((*camera.shape, 3), np.float32),
            is_lit=np.ones(camera.shape, np.bool_),
        )


@dataclass
class ScriptedDialogue:
    """Answers from a script, then as proposed; keeps what it was told and asked."""

    answers: list[str] = field(default_factory=list)
    """To ``choose``, in order; "interrupt" stands for Ctrl-C."""
    lines: list[str] = field(default_factory=list)
    questions: list[str] = field(default_factory=list)
    steps: list[tuple[str, int, int]] = field(default_factory=list)

    def announce(self, text: str) -> None:
        self.lines.append(text)

    def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
        self.steps.append((stage, n_done, n_all))

    def confirm(self, question: str) -> bool:
        self.questions.append(question)
        return True

    def choose(self, question: str, choices: Sequence[str]) -> str:
        self.questions.append(question)
        answer = self.answers.pop(0) if self.answers else choices[0]
        if answer == "interrupt":
            raise KeyboardInterrupt
        assert answer in choices
        return answer


@dataclass
class SmallTwin:
    """A bench on the twin, and the world behind it."""

    bench: Bench
    world: World
    dialogue: ScriptedDialogue

    def with_laboratory(self, laboratory: LaboratorySpec) -> "SmallTwin":
        """Let the rig file say something else than what is true."""
        return replace(self, bench=replace(self.bench, laboratory=laboratory))


def small_laboratory() -> LaboratorySpec:
    """The twin's laboratory, its camera with pixels twice as large."""
    laboratory = load_rig(TWIN_YAML).config.laboratory
    camera = laboratory.camera
    names = ("sensor_width_px", "sensor_height_px", "left_px", "width_px", "height_px")
    sizes = {name: getattr(camera, name) // 2 for name in names}
    camera = camera.model_copy(update={**sizes, "pixel_pitch_m": camera.pixel_pitch_m * 2})
    return laboratory.model_copy(update={"camera": camera})


def make_small_twin(
    settings: Settings | None = None, answers: Sequence[str] = (), **world_sections: Any
) -> SmallTwin:
    """Make a bench with connected devices.

    Sections of the world may be replaced; by default images are coarse, so that they cost little.
    """
    config = load_rig(TWIN_YAML).config
    assert config.world is not None
    coarse = {"surface": {"rays_per_pixel": 1}}
    setup = WorldSetup(
        config=WorldConfig.model_validate(
            {**config.world.model_dump(), **coarse, **world_sections}
        ),
        laboratory=small_laboratory(),
        load_heightmap=lambda: HeightMap(
            np.zeros((3, 5), np.float32), spacing_m=1.0, origin_trs_m=np.zeros(3)
        ),
    )
    world = World(setup, make_renderer=lambda _: DarkTerrain())
    devices = {}
    for kind in KINDS:
        context = DeviceContext(kind, options={}, seed=3, world=setup)
        context.shared[WORLD_KEY] = world
        devices[kind] = make_device(f"twin.{kind}", kind, context)
        devices[kind].connect()
    dialogue = ScriptedDialogue(list(answers))
    laboratory = setup.laboratory
    bench = Bench(
        Devices(**devices),
        laboratory,
        dialogue,
        laboratory.mounting.nominal,
        settings or Settings(),
    )
    return SmallTwin(bench, world, dialogue)
