"""Make the calibration record of the simulated laboratory anew.

Run from the root of the repository; it replaces calibration/records/twin.json:

    python calibration/calibrate_twin.py

For a rig of your own, copy this file and change the first three lines.
"""

import sys
from pathlib import Path

from tronlab.calib.wizard import CalibrationSettings, calibrate
from tronlab.campaign.live import open_live
from tronlab.campaign.provenance import software_versions
from tronlab.campaign.rig import load_rig
from tronlab.devices.registry import connected

RIG = Path("campaigns/rigs/twin.yaml")
RECORD = Path("calibration/records/twin.json")
SETTINGS = CalibrationSettings()

rig = load_rig(RIG)
with (
    open_live(sys.stderr) as live,
    connected(rig.open_devices(seed=0, session="calibration")) as devices,
):
    record = calibrate(
        devices,
        rig.config.laboratory,
        rig_name=rig.name,
        software=software_versions(),
        settings=SETTINGS,
        progress=live,
    )
record.save(RECORD)
print(RECORD)
