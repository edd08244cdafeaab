"""Dataset 0 of the paper in full on several simulated laboratories, against the figures to reach.

For each terrain (procedural, and a real map where its file is given) and each seed, another
laboratory is built: other mountings, lens, lamp place and noise, and for the procedural terrain
another terrain. It is calibrated, the straight line is recorded, all cores are scored, and a line a
core is printed beside the paper's own claim (section 4.1) and the project's.

    python benchmarks/dataset0.py [--seeds 1 2 3] [--map MAP.png] [--out out/dataset0]

Takes about three minutes a laboratory on two cores.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

from ruamel.yaml import YAML

ROOT = Path(__file__).parents[1]
CAMPAIGN = ROOT / "campaigns" / "straight_line.yaml"
RIG = ROOT / "campaigns" / "rigs" / "twin.yaml"
N_SHOTS = 61

LIMITS_PCT_LOS = {"paper": (1.0, 3.0), "refined": (0.1, 0.5)}
"""Mean and maximum of the position error: the paper's claim, and ours for refined cores."""

yaml = YAML()


def main() -> None:
    """Run every laboratory and print the table; exit code 1 if a figure is not reached."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--map", type=Path, help="16-bit PNG of a real terrain")
    parser.add_argument("--out", type=Path, default=Path("out/dataset0"))
    options = parser.parse_args()
    rows = [
        row
        for name, terrain in terrains(options.map)
        for seed in options.seeds
        for row in laboratory_rows(name, terrain, seed=seed, folder=options.out / f"{name}-{seed}")
    ]
    print(f"{'terrain':12} {'seed':>4}  {'core':14} {'solved':>7} {'mean %':>8} {'max %':>8}  goal")
    for row in rows:
        print(row["text"])
    sys.exit(0 if all(row["is_reached"] for row in rows) else 1)


def terrains(map_file: Path | None) -> Iterator[tuple[str, dict]]:
    """Give the terrains by name, as rig files describe them."""
    yield "procedural", {"kind": "procedural"}
    if map_file is not None:
        file = {"kind": "file", "path": str(map_file.resolve())}
        yield map_file.stem.split("_")[0], {**file, "size_m": [2.2, 4.2], "relief_m": 0.26}


def laboratory_rows(name: str, terrain: dict, *, seed: int, folder: Path) -> Iterator[dict]:
    """Build, calibrate, record and score one laboratory; give a row a core."""
    campaign = write_laboratory(terrain, seed=seed, folder=folder)
    result = folder / "result"
    if not (result / "summary.json").exists():
        tronlab(
            "calibrate", "all", "--rig", folder / "rig.yaml", "--record", folder / "record.json",
            "--force", "--yes",
        )  # fmt: skip
        tronlab("run", campaign, "--out", result, "--seed", seed)
        tronlab("score", result / "dataset.h5", "--out", result)
    summary = json.loads((result / "summary.json").read_text())
    for core, statistics in summary.items():
        yield row(name, seed, core, statistics)


def row(name: str, seed: int, core: str, statistics: dict) -> dict:
    """Set one core's statistics against its goal."""
    mean_goal, max_goal = LIMITS_PCT_LOS["refined" if core.endswith("refined") else "paper"]
    error, n_ok = statistics["position_error_pct_los"], statistics["n_ok"]
    is_reached = (
        statistics["n_shots"] == N_SHOTS
        and n_ok == N_SHOTS
        and error["mean"] <= mean_goal
        and error["max"] <= max_goal
    )
    text = (
        f"{name:12} {seed:4d}  {core:14} {n_ok:3d}/{N_SHOTS}"
        f" {error['mean']:8.4f} {error['max']:8.4f}"
        f"  <= {mean_goal} and <= {max_goal}: {'reached' if is_reached else 'NOT REACHED'}"
    )
    return {"text": text, "is_reached": is_reached}


def write_laboratory(terrain: dict, *, seed: int, folder: Path) -> Path:
    """Write rig and campaign of one laboratory; give the campaign's path."""
    folder.mkdir(parents=True, exist_ok=True)
    rig = yaml.load(RIG)
    rig["name"] = f"twin-{seed}"
    rig["terrain"] = {**terrain, **({"seed": seed} if terrain["kind"] == "procedural" else {})}
    rig["world"]["seed"] = seed
    yaml.dump(rig, folder / "rig.yaml")
    campaign = yaml.load(CAMPAIGN)
    campaign["rig"], campaign["calibration"] = "rig.yaml", "record.json"
    yaml.dump(campaign, folder / "campaign.yaml")
    return folder / "campaign.yaml"


def tronlab(*arguments: object) -> None:
    """Run a command of the tronlab beside this Python."""
    command = [str(Path(sys.executable).parent / "tronlab"), *map(str, arguments)]
    print("$", " ".join(["tronlab", *map(str, arguments)]), flush=True)
    subprocess.run(command, check=True)


if __name__ == "__main__":
    main()
