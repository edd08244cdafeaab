"""What the engine adds to a shot beyond its devices: a run whose steps take no time.

The same steps are called in a plain loop beside it; the difference is threads, messages, documents
and the looks for a stop. Ctrl-C is measured too: from the wish to stop at once, in the middle of a
step that hangs, to the call that stops the robot.

    python benchmarks/engine.py [--shots 500]
"""

import argparse
import statistics
import threading
import time
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

from scipy.spatial.transform import RigidTransform

from tronlab.campaign.config import GateConfig, RetryConfig, SuspendConfig
from tronlab.campaign.engine import run_shots
from tronlab.campaign.stop import RunStoppedError, StopRequest
from tronlab.devices.clock import WallClock
from tronlab.devices.readings import RobotTarget
from tronlab.planning.shots import Plan, Shot

LIMIT_MS = 25.0
"""Of engine and writer together; the writer is measured by ``benchmarks/recording.py``."""
STOP_LIMIT_MS = 100.0
N_STOPS = 20


class _IdleTaker:
    """Takes shots of nothing, in no time."""

    is_in_place = True
    clock = WallClock()

    def __init__(self) -> None:
        self.objections: dict[str, str] = {}
        self.config = SimpleNamespace(
            gate=GateConfig(), retry=RetryConfig(), suspend=SuspendConfig()
        )
        self.devices = SimpleNamespace(robot=SimpleNamespace(name="robot", stop=self.stop))
        self.hangs_until = threading.Event()
        self.hangs_until.set()
        self.on_move = lambda: None
        self.stopped_s = 0.0

    def warn(self, text: str) -> None:
        print(text)

    def stop(self) -> None:
        self.stopped_s = time.perf_counter()
        self.hangs_until.set()

    def begin(self, shot: Shot, attempt: int, *, n_failures: Any) -> None:
        self.shot, self.attempt = shot, attempt

    def check_room(self) -> None: ...

    def move(self) -> None:
        self.on_move()
        self.hangs_until.wait()

    def settle(self) -> dict[str, float]:
        return {"shift_m": 0.0, "turn_rad": 0.0}

    def measure(self) -> dict[str, float]:
        return {"tmac_trk_x_m": 1.0, "tmac_trk_y_m": 1.0, "tmac_trk_z_m": 1.0}

    def grab(self) -> dict[str, float]:
        return {"mean_grey": 1.0}

    def confirm(self) -> dict[str, float]:
        return {"exposure_shift_m": 0.0, "exposure_turn_rad": 0.0}

    def read(self) -> dict[str, float]:
        return {"rail_m": 0.0, "air_temperature_k": 293.0}

    def judge(self) -> dict[str, float]:
        return {"n_flags": 0}

    def assemble(self) -> SimpleNamespace:
        truth = SimpleNamespace(range_los_m=1.0, usable_fraction=1.0)
        return SimpleNamespace(shot_id=self.shot.shot_id, attempt=self.attempt, truth=truth)


def main() -> None:
    """Print the figures; exit code 1 if one is not reached."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shots", type=int, default=500)
    n_shots = parser.parse_args().shots
    plan = plan_of(n_shots)
    cpu_s = time.process_time()
    engine_ms = intervals_ms(plan)
    cpu_ms = 1e3 * (time.process_time() - cpu_s) / n_shots
    loop_ms = plain_loop_ms(plan)
    stops_ms = sorted(stop_ms() for _ in range(N_STOPS))
    median_ms = statistics.median(engine_ms)
    print(f"engine, {n_shots} shots: median {median_ms:.2f} ms a shot,")
    print(f"  95 % below {sorted(engine_ms)[int(0.95 * n_shots) - 1]:.2f} ms, CPU {cpu_ms:.2f} ms")
    print(f"plain loop over the same steps: {loop_ms:.3f} ms a shot")
    print(f"stop at once, {N_STOPS} times: robot told after {stops_ms[N_STOPS // 2]:.2f} ms,")
    print(f"  at most {stops_ms[-1]:.2f} ms")
    is_reached = median_ms < LIMIT_MS and stops_ms[-1] < STOP_LIMIT_MS
    print("reached" if is_reached else "NOT reached")
    raise SystemExit(not is_reached)


def plan_of(n_shots: int) -> Plan:
    """Give a plan of shots that are all the same."""
    here = RigidTransform.identity()
    return Plan(tuple(Shot(i, here, RobotTarget(0.0, here)) for i in range(1, n_shots + 1)))


def intervals_ms(plan: Plan) -> list[float]:
    """Give the time from one commit to the next."""
    times_s = [time.perf_counter()]
    run_shots(
        plan,
        _IdleTaker(),  # keeps what the engine asks of a ShotTaker
        commit=lambda record, replaces: times_s.append(time.perf_counter()),
        free_bytes=lambda: 10**12,
    )
    return [1e3 * (b - a) for a, b in pairwise(times_s)]


def plain_loop_ms(plan: Plan) -> float:
    """Give the time of a shot without any engine."""
    taker = _IdleTaker()
    begin_s = time.perf_counter()
    for shot in plan.shots:
        taker.begin(shot, 1, n_failures={})
        for step in (taker.move, taker.settle, taker.measure, taker.grab, taker.confirm):
            taker.check_room()
            step()
        for step in (taker.read, taker.judge, taker.assemble):
            step()
    return 1e3 * (time.perf_counter() - begin_s) / len(plan.shots)


def stop_ms() -> float:
    """Ask for a stop at once while a move hangs; give the time until the robot is told."""
    taker, stop = _IdleTaker(), StopRequest()
    asked_s = 0.0

    def ask_soon() -> None:
        nonlocal asked_s
        time.sleep(0.02)
        stop.ask()
        asked_s = time.perf_counter()
        stop.ask()

    taker.hangs_until.clear()
    taker.on_move = threading.Thread(target=ask_soon).start
    try:
        run_shots(plan_of(1), taker, commit=lambda record, replaces: None, stop=stop)
    except RunStoppedError:
        return 1e3 * (taker.stopped_s - asked_s)
    raise SystemExit("the run was not stopped")


if __name__ == "__main__":
    main()
