"""Ways of choosing features and matches are scored, and held against the core that they change."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from plane_dataset import N_SHOTS, write_plane_dataset
from small_study import write_small_study

from tronlab.campaign.live import SilentLive
from tronlab.dataset.reader import Dataset
from tronlab.errors import ConfigError
from tronlab.nav.database_file import read_database_file
from tronlab.study.config import SelectionConfig, SelectionVariant
from tronlab.study.pruned import half_name
from tronlab.study.selection import selection_steps
from tronlab.study.selection_table import ALL, selection_table
from tronlab.study.steps import Desk
from tronlab.study.study import Study, load_study

VARIANTS = {
    "mutual": {
        "step": "mutual",
        "settings": {"matching": {"mutual": True, "max_per_cell": 2, "best_by": "distance"}},
    },
    "alike": {"step": "refinement", "settings": {"pose": {"weigh_by_size": False}}},
    "strongest": {"step": "pruning", "prune_to": 0.5, "prune_by": "strength"},
    "verified": {"step": "pruning", "prune_to": 0.3, "prune_by": "scores"},
}


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


def study_with(folder: Path, variants: dict[str, dict[str, object]]) -> Study:
    study = load_study(write_small_study(folder, with_record=False))
    about = {"title": "a title", "base": "brisk-refined", "settings": {}}
    tried = {name: about | variant for name, variant in variants.items()}
    selection = SelectionConfig.model_validate({"datasets": ["dataset_0"], "variants": tried})
    return replace(study, config=study.config.model_copy(update={"selection": selection}))


def test_variants_are_scored_and_tabled(tmp_path: Path) -> None:
    study, out = study_with(tmp_path, VARIANTS), tmp_path / "out"
    (out / "datasets/dataset_0").mkdir(parents=True)
    write_plane_dataset(out / "datasets/dataset_0/dataset.h5")
    desk = Desk(out, 1, SilentLive())
    steps = selection_steps(study)
    for step in steps:
        step.run(desk)
        assert all((out / result).is_file() for result in step.results)

    table = pd.read_csv(out / "selection/selection.csv").set_index("variant")
    assert set(table.index) == {"brisk-refined", *VARIANTS}
    assert (table["n"] == N_SHOTS).all()
    assert (table["n_solved"] == N_SHOTS).all()
    scores = pd.read_csv(out / "selection/dataset_0/scores.csv")
    errors = scores.pivot_table(index="shot_id", columns="core", values="position_error_pct_los")
    gain = (errors["brisk-refined"] - errors["alike"]).mean()
    assert gain != 0
    assert table.loc["alike", "gain_pct_los"] == pytest.approx(gain)
    assert table.loc["alike", "gain_low"] < gain < table.loc["alike", "gain_high"]

    # What the even shots verified is tried on the odd ones, and the other way round.
    files = [out / f"selection/dataset_0/{name}.h5" for name in ("verified-even", "verified-odd")]
    even, odd = map(read_database_file, files)
    whole = read_database_file(out / "selection/dataset_0/landmarks-brisk-48px.h5")
    assert even.database.digest != odd.database.digest
    for chosen in (even, odd):
        assert len(chosen.database) == int(np.ceil(0.3 * len(whole.database)))
        assert chosen.about.prunings[0].datasets
    with Dataset(out / "datasets/dataset_0/dataset.h5") as dataset:
        is_odd = np.arange(N_SHOTS) % 2 == 1
        ids = dataset.shot_ids
    mean = [errors.loc[ids[~is_odd], half_name("verified", "even")],
            errors.loc[ids[is_odd], half_name("verified", "odd")]]  # fmt: skip
    assert table.loc["verified", "mean_pct_los"] == pytest.approx(pd.concat(mean).mean())


def test_keys_follow_the_variants(tmp_path: Path) -> None:
    def keys(variants: dict[str, dict[str, object]]) -> list[str]:
        return [step.key for step in selection_steps(study_with(tmp_path, variants))]

    changed = VARIANTS | {"alike": VARIANTS["alike"] | {"settings": {"pose": {"gate_px": 3}}}}
    assert keys(VARIANTS) == keys(VARIANTS)
    assert not set(keys(VARIANTS)) & set(keys(changed))


def test_a_variant_cannot_pass_for_a_built_in_core(tmp_path: Path) -> None:
    study = study_with(tmp_path, {"akaze": VARIANTS["alike"]})
    with pytest.raises(ConfigError, match=r"selection\.variants\.akaze: a built-in core"):
        selection_steps(study)


def test_datasets_are_taken_together_and_failures_leave_the_pairs(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)

    def scores(n: int, n_lost: int) -> pd.DataFrame:
        base = rng.uniform(0.5, 1.5, n)
        rows = []
        for core, error in (("brisk", base), ("better", base - 0.2 + 0.01 * rng.normal(size=n))):
            n_bad = n_lost if core == "better" else 0
            rows.append(
                pd.DataFrame(
                    {
                        "core": core,
                        "shot_id": np.arange(1, n + 1),
                        "seed": 0,
                        "status": ["no_pose"] * n_bad + ["ok"] * (n - n_bad),
                        "position_error_pct_los": [np.nan] * n_bad + error[n_bad:].tolist(),
                        "range_los_m": 2.0,
                        "n_matches": 100,
                        "n_inliers": 80,
                        "time_detect_s": 0.1,
                        "time_match_s": 0.2,
                        "time_pose_s": 0.3,
                    }
                )
            )
        return pd.concat(rows, ignore_index=True)

    variant = SelectionVariant.model_validate({"title": "t", "step": "ratio", "base": "brisk"})
    table = selection_table({"better": variant}, {"one": scores(20, 3), "other": scores(30, 0)})
    better = table[table["variant"] == "better"].set_index("dataset")
    assert better["n"].to_dict() == {"one": 20, "other": 30, ALL: 50}
    assert better["n_solved"].to_dict() == {"one": 17, "other": 30, ALL: 47}
    assert better["n_paired"].to_dict() == {"one": 17, "other": 30, ALL: 47}
    assert better["gain_pct_los"].tolist() == pytest.approx([0.2] * 3, abs=0.01)
    assert (better["gain_low"] < better["gain_pct_los"]).all()
    assert (better["gain_low"] > 0.19).all()
    assert (better["p"] < 1e-4).all()
    assert better["time_all_s"].tolist() == pytest.approx([0.6] * 3)
    assert better["inlier_share"].tolist() == pytest.approx([0.8] * 3)
    base = table[table["variant"] == "brisk"]
    assert base["gain_pct_los"].isna().all()
