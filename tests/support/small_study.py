"""A study of a small simulated laboratory in files: 64 x 64 pixels, a coarse terrain, few shots."""

from pathlib import Path
from typing import Any

from perfect_record import save_perfect_record
from ruamel.yaml import YAML

REPOSITORY = Path(__file__).resolve().parents[2]

CAMPAIGN = """\
name: small
rig: rig.yaml
calibration: record.json
trajectory:
  kind: straight_line
  start_trs_m: [1.08, 2.08, 3.0]
  end_trs_m: [1.08, 2.08, 2.0]
  n_points: 7
database:
  n_views: 2
  rays_per_pixel: 1
camera:
  exposure_s: 0.02
settle:
  wait_s: 0.0
drift: null
"""
STUDY = """\
name: tiny
title: A tiny study
laboratories:
  small: {rig: rig.yaml, record: record.json}
datasets:
  dataset_0: {campaign: campaign.yaml, laboratory: small}
  dataset_1_nominal: {campaign: campaign.yaml, laboratory: small}
cores: [brisk]
ablation:
  every_n: {dataset_0: 2}
  sources:
    noise:
      title: Noise of the sensor
      kind: camera
      rig: {world: {sensor: {read_noise_e: 0.0}}}
selection:
  datasets: [dataset_0]
  variants:
    ratio:
      title: Ratio test
      step: ratio
      base: brisk
      settings: {matching: {max_ratio: 0.5}}
load: {cores: [brisk], image_px: [128], n_features: [100], n_landmarks: [1000]}
quick:
  every_n: {dataset_0: 3}
  ablation_every_n: {dataset_0: 3}
  sources: [noise]
  larger: []
  selection: [ratio]
  load: {cores: [brisk], image_px: [64], n_features: [50], n_landmarks: [500]}
"""


def write_small_rig(folder: Path) -> Path:
    """Write the repository's twin, smaller, as rig.yaml; give its path."""
    yaml = YAML()
    rig: dict[str, Any] = yaml.load((REPOSITORY / "campaigns/rigs/twin.yaml").read_text())
    rig["laboratory"]["camera"].update(
        sensor_width_px=96,
        sensor_height_px=64,
        left_px=16,
        top_px=0,
        width_px=64,
        height_px=64,
        pixel_pitch_m=1e-4,
    )
    rig["terrain"].update(spacing_m=0.01)
    rig["world"]["surface"]["rays_per_pixel"] = 1
    rig["world"]["lens"]["principal_point_sigma_px"] = 1.0
    path = folder / "rig.yaml"
    with path.open("w") as file:
        yaml.dump(rig, file)
    return path


def write_small_study(folder: Path, *, with_record: bool = True) -> Path:
    """Write study, campaign, rig and, unless nobody reads it, a record; give the study's path."""
    write_small_rig(folder)
    if with_record:
        save_perfect_record(folder / "record.json", rig_path=folder / "rig.yaml")
    else:
        (folder / "record.json").write_text("{}")
    (folder / "campaign.yaml").write_text(CAMPAIGN)
    path = folder / "study.yaml"
    path.write_text(STUDY)
    return path
