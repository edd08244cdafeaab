"""Sweep files: what they mean, and what is wrong with them, by line and key."""

import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tronlab.errors import ConfigError
from tronlab.nav.settings import core_settings
from tronlab.nav.specs import CORE_NAME
from tronlab.score.sweep import SweepPlan, load_sweep, with_seeds

EXAMPLE = Path(__file__).parents[3] / "campaigns" / "sweeps" / "refined_pose.yaml"


def sweep(folder: Path, text: str, **options: Path) -> SweepPlan:
    path = folder / "sweep.yaml"
    path.write_text(text, encoding="utf-8")
    return load_sweep(path, **options)


def test_every_combination_is_a_variant_named_by_what_is_swept(tmp_path: Path) -> None:
    plan = sweep(
        tmp_path,
        """
cores:
  akaze-refined:
    settings: {detector: {n_max: 500}}
    sweep:
      pose.gate_px: [3, 6.0]
      pose.robust: [ransac, none]
  brisk:
  mine:
    core: "cmd:./my_core --cfg x.yaml"
    settings: {filter: {noise_px: 1}, mode: fast}
    sweep: {filter.gain: [0.001, null, true]}
seeds: [4, 1]
prior: {source: truth, position_sigma_m: 0.05, rotation_sigma_deg: 1}
time_limit_s: 5
""",
    )
    assert [variant.name for variant in plan.variants] == [
        "akaze-refined@gate_px=3,robust=ransac",
        "akaze-refined@gate_px=3,robust=none",
        "akaze-refined@gate_px=6,robust=ransac",
        "akaze-refined@gate_px=6,robust=none",
        "brisk",
        "mine@gain=0.001",
        "mine@gain=null",
        "mine@gain=true",
    ]
    second, mine = plan.variants[1], plan.variants[5]
    assert second.spec.target == "akaze-refined"
    assert second.spec.settings == {
        "detector": {"n_max": 500},
        "pose": {"gate_px": 3, "robust": "none"},
    }
    assert (second.core, dict(second.values)) == (
        "akaze-refined",
        {"pose.gate_px": 3, "pose.robust": "none"},
    )
    assert (mine.spec.kind, mine.spec.target) == ("command", "./my_core --cfg x.yaml")
    assert mine.spec.settings == {"filter": {"noise_px": 1, "gain": 0.001}, "mode": "fast"}
    assert plan.keys == ("pose.gate_px", "pose.robust", "filter.gain")
    assert plan.seeds == (4, 1)
    assert plan.prior is not None
    assert plan.time_limit_s == 5
    specs = with_seeds([variant.spec for variant in plan.variants], plan.seeds)
    assert [(spec.name, spec.seed) for spec in specs[:3]] == [
        ("akaze-refined@gate_px=3,robust=ransac", 4),
        ("akaze-refined@gate_px=3,robust=ransac", 1),
        ("akaze-refined@gate_px=3,robust=none", 4),
    ]


def test_keys_that_end_alike_stay_whole(tmp_path: Path) -> None:
    plan = sweep(tmp_path, "cores: {m: {core: 'cmd:m', sweep: {a.n: [1], b.n: [2], c.k: [3]}}}")
    assert plan.variants[0].name == "m@a.n=1,b.n=2,k=3"


def test_the_example_means_something_to_the_cores() -> None:
    plan = load_sweep(EXAMPLE)
    assert len(plan.variants) == 7
    for variant in plan.variants:
        settings = core_settings(variant.spec.target, variant.spec.settings)
        for key, value in variant.values.items():
            section, name = key.split(".")
            assert getattr(getattr(settings, section), name) == value


def test_databases_are_named_relative_to_the_file(tmp_path: Path) -> None:
    for name in ("all.h5", "own.h5", "told.h5"):
        (tmp_path / name).touch()
    text = (
        "database: all.h5\n"
        "cores:\n  akaze:\n  brisk: {settings: {database: own.h5}}\n  m: {core: 'cmd:m'}\n"
    )

    def databases(**options: Path) -> list[object]:
        plan = sweep(tmp_path, text, **options)
        return [variant.spec.settings.get("database") for variant in plan.variants]

    assert databases() == [str(tmp_path / "all.h5"), str(tmp_path / "own.h5"), None]
    told = tmp_path / "told.h5"
    assert databases(database=told) == [str(told), str(tmp_path / "own.h5"), None]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (
            "cores:\n  akaze:\n    sweep:\n      pose.gat_px: [3, 6]",
            "4: cores.akaze.sweep.pose.gat_px[0]: unknown key, did you mean gate_px?",
        ),
        (
            "cores:\n  akaze:\n    sweep:\n      pose.gate_px:\n        - 3\n        - -1",
            "6: cores.akaze.sweep.pose.gate_px[1]: must be greater than 0, got -1",
        ),
        (
            "cores:\n  akaze:\n    settings:\n      pose:\n        solver: p3p",
            "5: cores.akaze.settings.pose.solver: must be 'epnp' or 'sqpnp', got \"p3p\"",
        ),
        (
            "cores:\n  akaze: {settings: {database: no.h5}}",
            "2: cores.akaze.settings.database: no such file: ",
        ),
        (
            "cores:\n  akaze: {settings: {pose: {gate_px: 2}}, sweep: {pose.gate_px: [3]}}",
            "2: cores.akaze.sweep.pose.gate_px: stands in settings, too; remove it",
        ),
        (
            "cores:\n  m: {core: 'cmd:m', settings: {a: 1}, sweep: {a.b: [3]}}",
            "2: cores.m.sweep.a.b: stands in settings, too; remove it",
        ),
        (
            "cores:\n  m: {core: 'cmd:m', sweep: {a: [1], a.b: [3]}}",
            "2: cores.m.sweep.a: is swept, and so is a part of it",
        ),
        ("cores:\n  m: {core: 'cmd:m', sweep: {a..b: [1]}}", "2: cores.m.sweep.a..b: not a key"),
        ("cores:\n  m: {core: 'cmd:m', sweep: {a: []}}", "2: cores.m.sweep.a: no values to try"),
        ("cores:\n  m: {core: 'cmd:m', sweep: {a: [1, 1]}}", "2: cores.m.sweep.a: 1 stands twice"),
        (
            "cores:\n  m: {core: 'cmd:m', sweep: {a: [x/y, x y]}}",
            "1: cores: two variants are called m@a=x_y",
        ),
        ("cores:\n  m:\n    core: 'cmd:'", "3: cores.m.core: navigation core 'cmd:': no program"),
        ("cores:\n  m/n: {core: akaze}", "2: cores.m/n.core: navigation core 'm/n=akaze': "),
        ("cores: {akaze: }\nseeds: [1, 1]", "2: seeds: 1 stands twice"),
        ("cores: {akaze: }\nprio: 3", "2: prio: unknown key, did you mean prior?"),
        ("cores: {}", "1: cores: "),
        (
            f"cores:\n  m: {{core: 'cmd:m', sweep: {{a: {[*range(40)]}, b: {[*range(26)]}}}}}",
            "1: cores: 1040 variants are more than max_variants allows, 1000;",
        ),
    ],
)
def test_a_mistake_is_told_by_line_and_key(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(ConfigError) as told:
        sweep(tmp_path, text)
    assert str(told.value).startswith(f"{tmp_path / 'sweep.yaml'}:{problem}")
    assert "\n" not in str(told.value)


def test_a_larger_sweep_can_be_asked_for(tmp_path: Path) -> None:
    values = list(range(1001))
    text = f"cores: {{m: {{core: 'cmd:m', sweep: {{a: {values}}}}}}}\nmax_variants: 1001"
    assert len(sweep(tmp_path, text).variants) == 1001


@settings(deadline=None, max_examples=50)
@given(
    counts=st.lists(st.integers(1, 4), max_size=4),
    text=st.text(st.characters(min_codepoint=32, max_codepoint=300), min_size=1, max_size=8),
)
def test_names_are_distinct_and_can_be_filed(
    tmp_path_factory: pytest.TempPathFactory, counts: list[int], text: str
) -> None:
    keys = {f"s{i}.key": [f"{text} {value}" for value in range(n)] for i, n in enumerate(counts)}
    lines = [
        f"      {key}: {[*map(_quoted, values)]}".replace("'", "") for key, values in keys.items()
    ]
    swept = "\n".join(["    sweep:", *lines]) if lines else ""
    plan = sweep(tmp_path_factory.getbasetemp(), f"cores:\n  m:\n    core: cmd:m\n{swept}\n")
    names = [variant.name for variant in plan.variants]
    assert len(names) == len(set(names)) == math.prod(counts)
    assert all(CORE_NAME.fullmatch(name) for name in names)


def _quoted(text: str) -> str:
    return '"' + "".join(f"\\u{ord(character):04x}" for character in text) + '"'
