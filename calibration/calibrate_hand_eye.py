"""Find where the camera sits on the T-MAC, and print what the answer is worth.

    python calibration/calibrate_hand_eye.py

The camera is calibrated from the same stations. Nothing is written; add ``record`` lines as in
calibrate_twin.py to keep the answer.
"""

import sys
from pathlib import Path

import numpy as np

from tronlab.calib.inputs import Inputs
from tronlab.calib.solve import solve
from tronlab.calib.wizard import Bench, Settings, Unattended, measure_stations
from tronlab.campaign.live import open_live
from tronlab.campaign.rig import load_rig
from tronlab.devices.registry import connected

RIG = Path("campaigns/rigs/twin.yaml")
SETTINGS = Settings(n_stations=20)

rig = load_rig(RIG)
laboratory = rig.config.laboratory
with open_live(sys.stderr) as live, connected(rig.open_devices(seed=0)) as devices:
    bench = Bench(devices, laboratory, Unattended(live), laboratory.mounting.nominal, SETTINGS)
    measured = measure_stations(bench)

results = solve(Inputs(hand_eye=measured))
if results.hand_eye is None:
    sys.exit("no hand-eye transform")
sigma = np.sqrt(np.diag(results.hand_eye.covariance))
print("tmac_from_cam, metres:\n", results.hand_eye.tmac_from_cam.as_matrix())
print("one sigma of a turn about x y z:", np.degrees(sigma[:3]) * 1e3, "mdeg")
print("one sigma of a shift along x y z:", sigma[3:] * 1e3, "mm")
print("least determined:", results.hand_eye.statistics["least_determined"])
print("outlier stations:", results.hand_eye.statistics["outlier_stations"])
