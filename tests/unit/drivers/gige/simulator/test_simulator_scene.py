"""The simulated laboratory before the camera, above all what is rendered before it is asked for."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.gige.simulator import scene as module
from drivers.gige.simulator.scene import Exposure, Region, WorldScene
from tronlab.campaign.rig import load_rig
from tronlab.errors import NotConnectedError
from tronlab.render.renderer import Rendering
from tronlab.terrain.heightmap import HeightMap
from tronlab.twin.instruments import CameraOptics, noise_of
from tronlab.twin.state import LocalState, WorldState
from tronlab.twin.world import World, WorldSetup, initial_state

TWIN_YAML = Path(__file__).parents[5] / "campaigns" / "rigs" / "twin.yaml"
SENSOR = {"sensor_width_px": 85, "sensor_height_px": 64, "pixel_pitch_m": 16 * 6.45e-6}
FULL = Region(left_px=10, top_px=0, width_px=64, height_px=60)
PART = Region(left_px=20, top_px=4, width_px=32, height_px=16)
LOOKER = "camera look-ahead"


class SlowRenderer:
    """A terrain of one radiance everywhere, rendered when the test lets it."""

    def __init__(self) -> None:
        self.shapes: list[tuple[int, ...]] = []
        self.begun = threading.Semaphore(0)
        self.is_allowed = threading.Event()
        self.is_allowed.set()

    def render(self, camera: Any, *_: Any, **__: Any) -> Rendering:
        self.shapes.append(tuple(camera.shape))
        self.begun.release()
        assert self.is_allowed.wait(30.0)
        return Rendering(
            radiance=np.full(camera.shape, 0.02, np.float32),
            depth_m=np.ones(camera.shape, np.float32),
            points_trs_m=np.zeros((*camera.shape, 3), np.float32),
            is_lit=np.ones(camera.shape, np.bool_),
        )

    def wait(self) -> None:
        """Wait until one more rendering has begun."""
        assert self.begun.acquire(timeout=30.0), "nothing was rendered"


class Laboratory(LocalState):
    """A state that counts who reads it; it may move all the time, or be served by nobody."""

    def __init__(self, state: WorldState) -> None:
        super().__init__(state)
        self.n_reads = 0
        self.is_moving = self.is_gone = False

    def read(self) -> WorldState:
        self.n_reads += 1
        if self.is_gone:
            raise NotConnectedError("nobody answers", device="simulated world")
        if self.is_moving:
            self.move()
        return super().read()

    def move(self) -> None:
        robot = self._state.robot_actual
        self.change(robot_actual=replace(robot, rail_m=robot.rail_m + 1e-3))

    def wait_for_looks(self, n: int) -> None:
        wanted = self.n_reads + n
        wait_until(lambda: self.n_reads >= wanted)


def wait_until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 30.0
    while not condition():
        assert time.monotonic() < end_s, "it never happened"
        time.sleep(0.001)


@pytest.fixture(autouse=True)
def _looks_are_frequent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_LOOK_S", 0.005)


@pytest.fixture
def renderer() -> Iterator[SlowRenderer]:
    renderer = SlowRenderer()
    yield renderer
    renderer.is_allowed.set()


@pytest.fixture(scope="module")
def setup() -> WorldSetup:
    """The twin's laboratory with a coarse sensor."""
    rig = load_rig(TWIN_YAML).config
    assert rig.world is not None
    camera = rig.laboratory.camera.model_copy(
        update={**SENSOR, **{key: getattr(FULL, key) for key in FULL.__slots__}}
    )
    lens = rig.world.lens.model_copy(update={"principal_point_sigma_px": 0.5})
    return WorldSetup(
        rig.world.model_copy(update={"lens": lens}),
        rig.laboratory.model_copy(update={"camera": camera}),
        lambda: HeightMap(np.zeros((3, 3), np.float32), 0.1, np.zeros(3)),
    )


@pytest.fixture
def state(setup: WorldSetup) -> Laboratory:
    state = Laboratory(initial_state(setup))
    state.change(lamp_level=1.0)
    return state


@pytest.fixture
def world(setup: WorldSetup, state: Laboratory, renderer: SlowRenderer) -> World:
    return World(setup, state=state, make_renderer=lambda _: renderer)


@pytest.fixture
def look(world: World) -> Iterator[Callable[[], WorldScene]]:
    """Begin to look; closed at the end."""
    with ExitStack() as stack:

        def begin() -> WorldScene:
            scene = WorldScene(world, noise())
            stack.callback(scene.close)
            return scene

        yield begin


def noise() -> np.random.Generator:
    return noise_of("camera", seed=7, session="run")


def exposure(region: Region = FULL) -> Exposure:
    return Exposure(block_id=1, region=region, exposure_s=0.02, gain_db=0.0, pixel_format="Mono12")


def n_lookers() -> int:
    return sum(thread.name == LOOKER for thread in threading.enumerate())


def test_what_stands_still_is_rendered_once_and_before_it_is_asked_for(
    look, state: Laboratory, renderer: SlowRenderer
) -> None:
    scene = look()
    renderer.wait()
    state.wait_for_looks(10)
    for _ in range(3):
        scene.image(exposure())
    assert renderer.shapes == [(60, 64)]


def test_images_are_the_twin_s_bit_for_bit_however_often_it_was_looked_at(
    look, world: World, state: Laboratory
) -> None:
    scene, twin = look(), CameraOptics(world, noise())
    for _ in range(3):
        state.move()
        state.wait_for_looks(5)
        expected = twin.image(exposure_s=0.02, gain_db=0.0, pixel_format="Mono12")
        image = scene.image(exposure())
        assert image.std() > 0
        np.testing.assert_array_equal(image, expected)


def test_what_moves_is_not_rendered_until_it_stands(
    look, state: Laboratory, renderer: SlowRenderer
) -> None:
    state.is_moving = True
    look()
    state.wait_for_looks(20)
    assert renderer.shapes == []
    state.is_moving = False
    renderer.wait()


def test_an_image_of_what_moves_is_rendered_when_asked_for(
    look, state: Laboratory, renderer: SlowRenderer
) -> None:
    state.is_moving = True
    assert look().image(exposure()).shape == (60, 64)
    assert renderer.shapes == [(60, 64)]


def test_the_region_of_the_latest_image_is_looked_at(
    look, state: Laboratory, renderer: SlowRenderer
) -> None:
    assert look().image(exposure(PART)).shape == (16, 32)
    state.move()
    wait_until(lambda: renderer.shapes.count((16, 32)) == 2)


def test_an_image_asked_for_while_its_view_is_rendered_waits_for_it(
    look, state: Laboratory, renderer: SlowRenderer
) -> None:
    renderer.is_allowed.clear()
    scene = look()
    renderer.wait()
    images: list[Any] = []
    asker = threading.Thread(target=lambda: images.append(scene.image(exposure())))
    asker.start()
    assert not images
    renderer.is_allowed.set()
    asker.join(30.0)
    assert [image.shape for image in images] == [(60, 64)]
    assert renderer.shapes == [(60, 64)]


def test_it_looks_on_when_a_laboratory_that_nobody_served_is_back(
    look, state: Laboratory, renderer: SlowRenderer
) -> None:
    state.is_gone = True
    scene = look()
    state.wait_for_looks(5)
    with pytest.raises(NotConnectedError):
        scene.image(exposure())
    assert renderer.shapes == []
    state.is_gone = False
    renderer.wait()


def test_closing_waits_for_what_is_being_rendered_and_leaves_no_thread(
    look, renderer: SlowRenderer
) -> None:
    before = n_lookers()
    renderer.is_allowed.clear()
    scene = look()
    assert n_lookers() == before + 1
    renderer.wait()
    closer = threading.Thread(target=scene.close)
    closer.start()
    closer.join(0.05)
    assert closer.is_alive()
    renderer.is_allowed.set()
    closer.join(30.0)
    assert n_lookers() == before
    scene.close()
