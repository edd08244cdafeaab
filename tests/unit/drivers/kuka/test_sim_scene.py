"""The simulated laboratory behind the simulated controller."""

import time
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from drivers.kuka.simulator.command import Command, CommandType, Refusal
from drivers.kuka.simulator.controller import Controller
from drivers.kuka.simulator.machine import Machine, position_of
from drivers.kuka.simulator.scene import WorldScene
from tronlab.campaign.rig import load_rig
from tronlab.devices.readings import RobotTarget
from tronlab.twin.config import FaultSpec
from tronlab.twin.instruments import Positioning, noise_of
from tronlab.twin.state import ArmedFaults
from tronlab.twin.world import World, WorldSetup

TWIN_YAML = Path(__file__).parents[4] / "campaigns" / "rigs" / "twin.yaml"
MACHINE = Machine(rail_range_mm=(-50.0, 4450.0))


@pytest.fixture(scope="module")
def rig():
    return load_rig(TWIN_YAML)


@pytest.fixture
def make_world(rig):
    def make(*faults: FaultSpec) -> World:
        config = rig.config.world.model_copy(update={"faults": faults})
        return World(WorldSetup(config, rig.config.laboratory, lambda: pytest.fail("no terrain")))

    return make


def noise():
    return noise_of("robot", seed=3, session="run")


def move(controller, number, *, by):
    axes = controller.state.commanded + by
    controller.write(Command(number, CommandType.PTP_AXIS, 100.0, 100.0, axes, position_of(axes)))
    end = time.monotonic() + 10.0
    while controller.state.done != number:
        assert time.monotonic() < end
        time.sleep(0.005)
    return controller.state


@pytest.fixture
def start(make_world):
    controllers = []

    def start_one(*faults: FaultSpec):
        world = make_world(*faults)
        controllers.append(
            Controller(WorldScene(world, noise()), ArmedFaults(), machine=MACHINE, override_pct=100)
        )
        return world, controllers[-1]

    yield start_one
    for controller in controllers:
        controller.close()


def close_to(target: RobotTarget, other: RobotTarget, *, atol: float) -> bool:
    return abs(target.rail_m - other.rail_m) <= atol and np.allclose(
        target.base_from_flange.as_matrix(), other.base_from_flange.as_matrix(), atol=atol
    )


def test_robot_stands_where_the_laboratory_parked_it_and_moves_nothing(start):
    world, controller = start()
    before = world.state.read()
    time.sleep(0.1)
    assert world.state.read() == before
    assert controller.state.measured[6] == world.robot_at.rail_m * 1000


def test_every_move_has_the_errors_of_the_twin_in_one_process(start, make_world):
    world, controller = start()
    twin = make_world()
    positioning = Positioning(twin, noise())
    for number, step in enumerate(
        [[2, 0, 0, 0, 0, 0, 12], [0, 1, 0, 0, 0, 0, 0], [0, 0, -1, 0, 3, 0, -5]], start=1
    ):
        move(controller, number, by=np.array(step, dtype=float))
        target = world.robot_at
        actual = positioning.actual(target)
        twin.stand_robot(target, actual=actual)
        assert close_to(world.state.read().robot_actual.target, actual, atol=1e-12)
        assert not close_to(actual, target, atol=1e-6)


def test_error_grows_on_the_way_from_the_last_to_the_next(make_world):
    world = make_world()
    scene = WorldScene(world, noise())
    start, positioning = scene.robot_at(), Positioning(make_world(), noise())
    goal = RobotTarget(
        start.rail_m + 0.1, RigidTransform.from_translation([0.01, 0, 0]) * start.base_from_flange
    )
    end = positioning.actual(goal)
    scene.begin_move(goal)
    offsets = []
    for progress in (0.0, 0.25, 0.5, 1.0):
        scene.stand(goal, progress=progress)
        offsets.append(world.state.read().robot_actual.rail_m - goal.rail_m)
    np.testing.assert_allclose(
        offsets, (end.rail_m - goal.rail_m) * np.array([0.0, 0.25, 0.5, 1.0]), atol=1e-12
    )


def test_scripted_fault_strikes_at_its_move(start):
    world, controller = start(FaultSpec(device="robot", call="move", at=2, error="fault"))
    step = np.array([1.0, 0, 0, 0, 0, 0, 0])
    outcomes = []
    for number in (1, 2, 3):
        before = world.state.read()
        outcomes.append(move(controller, number, by=step).refusal)
        assert (world.state.read() == before) is (outcomes[-1] is Refusal.FAILED)
    assert outcomes == [Refusal.NONE, Refusal.FAILED, Refusal.NONE]
