"""Calibrate the simulated laboratory, whole or one part of it.

Run from the root of the repository; it replaces calibration/records/twin.json:

    python calibration/calibrate_twin.py
    python calibration/calibrate_twin.py frame      # the tracker was moved: only this

For a rig of your own, copy this file and change the first three lines. ``tronlab calibrate`` does
the same, asks before each move, and loses nothing: the old record is kept, and what was measured
before an interruption.
"""

import sys
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from tronlab.calib.record import CalibrationRecord
from tronlab.calib.results import Results
from tronlab.calib.wizard import ALL_PARTS, Bench, Settings, Unattended, calibrate
from tronlab.campaign.live import open_live
from tronlab.campaign.provenance import device_identities, software_versions
from tronlab.campaign.rig import load_rig
from tronlab.devices.registry import connected

RIG = Path("campaigns/rigs/twin.yaml")
RECORD = Path("calibration/records/twin.json")
SETTINGS = Settings(n_stations=20, n_reflector_readings=8)

parts = [part.replace("-", "_") for part in sys.argv[1:]] or ALL_PARTS
if unknown := set(parts) - {*ALL_PARTS, "intrinsics"}:
    sys.exit(f"no part is called {', '.join(sorted(unknown))}: {', '.join(ALL_PARTS)}, intrinsics")
rig = load_rig(RIG)
laboratory = rig.config.laboratory
with (
    open_live(sys.stderr) as live,
    connected(rig.open_devices(seed=0, session=f"calibration of {parts}")) as devices,
):
    identities = device_identities(devices)
    draft = CalibrationRecord(
        rig_name=rig.name,
        created_utc=f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        software=software_versions(),
        devices={name: identities[name] for name in ("camera", "tracker", "tmac")},
        results=Results(),
        valid_days=rig.config.calibration.valid_days,
    )
    if parts != ALL_PARTS:
        draft = replace(draft, inputs=CalibrationRecord.load(RECORD).inputs)
    bench = Bench(devices, laboratory, Unattended(live), laboratory.mounting.nominal, SETTINGS)
    record = calibrate(parts, bench, draft)
record.save(RECORD)
print(RECORD)
