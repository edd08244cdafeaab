"""A campaign through the real drivers, over sockets, against simulators in their own processes."""

import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recorder import Recorder
from ruamel.yaml import YAML
from scipy.stats import chi2
from wire_laboratory import WireLaboratory, write_yaml

from tronlab.campaign.run import run_campaign
from tronlab.dataset.reader import Dataset
from tronlab.dataset.validate import validate
from tronlab.errors import NotConnectedError
from tronlab.twin.instruments import CameraOptics, noise_of
from tronlab.twin.state import WorldState
from tronlab.twin.world import World

Start = Callable[..., WireLaboratory]
SEED = 3


def at_shots(action: Callable[[int], None]) -> Recorder:
    """Make a live view that acts when a shot was committed."""

    def act(stage: str, n_done: int) -> None:
        if stage == "shots" and n_done:
            action(n_done)

    return Recorder(act)


def later(delay_s: float, action: Callable[[], None]) -> threading.Timer:
    timer = threading.Timer(delay_s, action)
    timer.start()
    return timer


def ids_of(path: Path) -> list[int]:
    with Dataset(path) as dataset:
        return [int(shot_id) for shot_id in dataset.shot_ids]


@pytest.mark.parametrize("protocol", ["eki", "kvp"])
def test_the_campaign_runs_unchanged_and_gives_the_same(
    start_wire: Start,
    campaign_path: Path,
    replay: Callable[[WireLaboratory], World],
    tmp_path: Path,
    protocol: str,
):
    """Same shots; truth within the tracker's noise; equal images where the true pose is equal."""
    wire = start_wire(protocol=protocol)
    states: list[WorldState] = []
    live = at_shots(lambda _n_done: states.append(wire.state.read()))
    path = run_campaign(
        campaign_path, rig_path=wire.rig.path, out_dir=tmp_path / "wire", seed=SEED, live=live
    )
    in_process = run_campaign(campaign_path, out_dir=tmp_path / "twin", seed=SEED)
    assert validate(path) == []

    world = replay(wire)
    optics = CameraOptics(world, noise_of("camera", seed=SEED, session="run"))
    misfits: list[float] = []
    with Dataset(path) as dataset, Dataset(in_process) as other:
        assert dataset.status == other.status == "complete"
        assert list(dataset.shot_ids) == list(other.shot_ids) == [1, 2, 3]
        assert len(states) == dataset.n_shots
        for i, state in enumerate(states):
            shot, twin_shot = dataset.shot(i), other.shot(i)
            nominal = shot.trs_from_cam_nominal.as_matrix()
            np.testing.assert_array_equal(nominal, twin_shot.trs_from_cam_nominal.as_matrix())
            assert shot.robot.rail_m == pytest.approx(twin_shot.robot.rail_m, abs=1e-6)
            assert shot.tracker.air is not None
            assert shot.tracker.air.temperature_k == pytest.approx(shot.room.air_temperature_k)
            assert shot.room.is_lamp_on

            world.state.change(
                robot_actual=state.robot_actual,
                lamp_level=state.lamp_level,
                trs_from_board=state.trs_from_board,
            )
            misfits.append(misfit(shot.truth, world))
            image = optics.image(exposure_s=0.02, gain_db=0.0, pixel_format="Mono8")
            np.testing.assert_array_equal(shot.frame.image, image)
    assert sum(misfits) < chi2.ppf(1 - 1e-6, 6 * len(misfits))
    assert not live.said("differ by")


def misfit(truth: Any, world: World) -> float:
    """Give the squared error of a shot's truth in units of its covariance; chi-square of 6."""
    error = truth.trs_from_cam * world.truth.trs_from_cam.inv()
    vector = np.concatenate(
        [
            error.rotation.as_rotvec(),
            truth.trs_from_cam.translation - world.truth.trs_from_cam.translation,
        ]
    )
    return float(vector @ np.linalg.solve(truth.covariance, vector))


@dataclass(frozen=True, slots=True)
class Trouble:
    """What goes wrong before a shot, and what is said about it."""

    begin: Callable[[WireLaboratory], None]
    says: str
    lasts_s: float = 0.0
    end: Callable[[WireLaboratory], None] | None = None
    """None: it ends by itself."""


def once(fault: str, says: str) -> Trouble:
    return Trouble(lambda wire: wire.state.arm(fault, times=1), says)


def lasting(fault: str, lasts_s: float, says: str) -> Trouble:
    return Trouble(
        lambda wire: wire.state.arm(fault),
        says,
        lasts_s,
        lambda wire: wire.state.arm(fault, times=0),
    )


OPEN_DOOR = Trouble(
    lambda wire: wire.state.change(is_door_closed=False),
    "waiting before shot 4: room: the door is open",
    1.5,
    lambda wire: wire.state.change(is_door_closed=True),
)


@pytest.mark.parametrize(
    "troubles",
    [
        (
            once("tracker.beam_breaks", "tracker: "),
            once("tracker.disconnect", "tracker: "),
            once("camera.ignores_trigger", "camera: grab: no frame"),
        ),
        (
            lasting("camera.gone", 3.0, "camera: "),
            lasting("robot.emergency_stop", 1.5, "waiting before shot 3: robot: "),
            OPEN_DOOR,
            lasting("room.silent", 2.0, "room: "),
        ),
    ],
    ids=["once", "lasting"],
)
def test_troubles_that_pass_cost_time_but_no_shot(
    wire: WireLaboratory, campaign_path: Path, tmp_path: Path, troubles: Sequence[Trouble]
):
    """One before every shot but the first, so that all but the last are seen to leave no trace."""
    n_shots = 1 + len(troubles)
    root = YAML().load(campaign_path.read_text())
    root["trajectory"]["n_points"] = n_shots
    write_yaml(campaign_path, root)
    n_said: list[int] = []

    def strike(n_done: int) -> None:
        n_said.append(len(live.texts))
        if n_done <= len(troubles):
            trouble = troubles[n_done - 1]
            trouble.begin(wire)
            if trouble.end is not None:
                later(trouble.lasts_s, partial(trouble.end, wire))

    live = at_shots(strike)
    path = run_campaign(campaign_path, rig_path=wire.rig.path, out_dir=tmp_path / "out", live=live)
    for trouble, begin, end in zip(troubles, n_said[:-1], n_said[1:], strict=True):
        said = live.texts[begin:end]
        assert any(trouble.says in text for text in said), (trouble.says, said)
    assert ids_of(path) == list(range(1, n_shots + 1))
    assert validate(path) == []
    with Dataset(path) as dataset:
        attempts = [dataset.shot(i).attempt for i in range(n_shots)]
    assert attempts[0] == 1
    assert min(attempts[1:]) > 1, attempts


def test_a_tracker_pushed_on_the_wire_is_found_and_the_shots_are_suspect(
    wire: WireLaboratory, campaign_path: Path, tmp_path: Path
):
    root = YAML().load(campaign_path.read_text())
    root["trajectory"]["n_points"] = 2
    write_yaml(campaign_path, {**root, "drift": {"window_s": 0.1}})
    shift_m = (0.002, -0.001, 0.002)
    live = at_shots(lambda _n_done: wire.state.change(tracker_shift_m=shift_m))
    path = run_campaign(campaign_path, rig_path=wire.rig.path, out_dir=tmp_path / "out", live=live)
    assert live.said("drift check at the start: nothing moved"), live.texts
    assert live.said("drift check after 2 shots: the tracker moved"), live.texts
    with Dataset(path) as dataset:
        assert dataset.truth_states == ("suspect", "suspect")
        assert dataset.drift_checks[-1].max_shift_m == pytest.approx(0.003, abs=5e-4)


@pytest.mark.parametrize("kind", ["camera", "robot"])
def test_a_device_that_dies_ends_the_campaign_and_the_dataset_is_readable(
    start_wire: Start, campaign_path: Path, tmp_path: Path, kind: str
):
    wire = start_wire()
    root = YAML().load(campaign_path.read_text())
    root["retry"]["lost_connection"]["max_attempts"] = 2
    write_yaml(campaign_path, root)

    def kill(n_done: int) -> None:
        if n_done == 1:
            next(s for s in wire.fleet.simulators if s.kind == kind).close()

    began = time.monotonic()
    with pytest.raises(Exception, match=f"{kind}: ") as caught:
        run_campaign(
            campaign_path,
            rig_path=wire.rig.path,
            out_dir=tmp_path / "out",
            live=at_shots(kill),
        )
    assert isinstance(caught.value, (NotConnectedError, TimeoutError)), caught.value
    assert time.monotonic() - began < 120
    with Dataset(tmp_path / "out" / "dataset.h5") as dataset:
        assert dataset.status == "failed"
        assert dataset.reason.startswith("shot 2, attempt ")
        assert [dataset.image(i).shape for i in range(dataset.n_shots)] == [(128, 128)]
