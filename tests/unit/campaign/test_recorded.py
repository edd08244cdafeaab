from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from records import make_record, make_results

from tronlab.campaign.recorded import recorded_database, recorded_heightmap, recorded_terrain
from tronlab.campaign.rig import load_rig
from tronlab.dataset.records import Provenance
from tronlab.errors import ConfigError
from tronlab.geometry.camera import CameraModel

REPOSITORY = Path(__file__).parents[3]
TWIN = REPOSITORY / "campaigns/rigs/twin.yaml"


def silent(text: str) -> None: ...


@pytest.mark.parametrize("path", [TWIN, REPOSITORY / "campaigns/rigs/wire.yaml"], ids=str)
def test_the_terrain_is_that_of_the_rig_also_of_a_variant(path: Path) -> None:
    rig = load_rig(path)
    assert recorded_terrain(rig.whole_text) == rig.config.terrain


def test_a_variant_s_own_terrain_counts(tmp_path: Path) -> None:
    variant = tmp_path / "variant.yaml"
    variant.write_text(f"extends: {TWIN}\nterrain: {{kind: procedural, seed: 7}}\n")
    assert recorded_terrain(load_rig(variant).whole_text).seed == 7


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: x\n", "has no terrain; name the rig file"),
        ("terrain: {kind: sand}\n", r"rig\.terrain"),
        ("a: [\n", "the recorded rig is no YAML"),
    ],
)
def test_a_rig_that_does_not_tell_is_one_clear_error(text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        recorded_terrain(text)


def test_a_terrain_from_a_file_needs_the_rig_file_that_leads_to_it(
    tmp_path: Path, make_provenance: Callable[..., Provenance]
) -> None:
    heights = (np.arange(64 * 64).reshape(64, 64) * 10).astype(np.uint16)
    Image.fromarray(heights).save(tmp_path / "dem.png")
    rig_path = tmp_path / "rig.yaml"
    terrain = "{kind: file, path: dem.png, size_m: [0.64, 0.64], spacing_m: 0.01}"
    rig_path.write_text(f"extends: {TWIN}\nterrain: {terrain}\n")
    provenance = replace(make_provenance(), rig_yaml=load_rig(rig_path).whole_text)
    with pytest.raises(ConfigError, match=r"file dem\.png; name the rig file .*--rig RIG\.yaml"):
        recorded_heightmap(provenance, None, announce=silent)
    found = recorded_heightmap(provenance, rig_path, announce=silent)
    np.testing.assert_array_equal(found.height_m, load_rig(rig_path).load_heightmap().height_m)
    with pytest.raises(ConfigError, match=r"twin\.yaml: terrain: is not the terrain"):
        recorded_heightmap(provenance, TWIN, announce=silent)


def test_the_database_is_rendered_as_the_campaign_said(
    make_provenance: Callable[..., Provenance],
) -> None:
    record = make_record(make_results(camera=CameraModel(16, 12, 12.0, 12.0, 7.5, 5.5)))
    text = "database: {n_views: 3, rays_per_pixel: 1}\nunknown: 1\n"
    images = recorded_database(replace(make_provenance(), campaign_yaml=text), record)
    assert (images.rays_per_pixel, images.photometry.kind) == (1, "lambert")
    assert recorded_database(make_provenance(), record).rays_per_pixel == 4
    wrong = replace(make_provenance(), campaign_yaml="database: {rays: 1}\n")
    with pytest.raises(ConfigError, match="database"):
        recorded_database(wrong, record)
