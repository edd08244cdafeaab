"""Find the model frame from its reflectors and print it; nothing moves, nothing is written.

python calibration/calibrate_frame.py
"""

import sys
from pathlib import Path

import numpy as np

from tronlab.calib.inputs import point_readings
from tronlab.calib.reflectors.frame import solve_frame
from tronlab.calib.wizard import Bench, Unattended, measure_frame
from tronlab.campaign.live import open_live
from tronlab.campaign.rig import load_rig
from tronlab.devices.registry import connected

RIG = Path("campaigns/rigs/twin.yaml")

rig = load_rig(RIG)
laboratory = rig.config.laboratory
with open_live(sys.stderr) as live, connected(rig.open_devices(seed=0), ("tracker",)) as devices:
    bench = Bench(devices, laboratory, Unattended(live), laboratory.mounting.nominal)
    measured = measure_frame(bench)

frame = solve_frame(point_readings(measured.points), measured.reflectors)
sigma = np.sqrt(np.diag(frame.covariance))
print("trs_from_trk, metres:\n", frame.trs_from_trk.as_matrix())
print("one sigma of a turn about x y z:", np.degrees(sigma[:3]) * 1e3, "mdeg")
print("one sigma of a shift along x y z:", sigma[3:] * 1e3, "mm")
for pair, error_m in frame.statistics["length_errors_m"].items():
    print(f"{pair}: {error_m * 1e3:+.3f} mm against the rig file")
