from pathlib import Path

import pytest

from tronlab.campaign.schema import generated_files, write_generated_files

REPOSITORY = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize("path", generated_files(), ids=str)
def test_committed_file_is_fresh(path: Path) -> None:
    committed = (REPOSITORY / path).read_text(encoding="utf-8")
    assert committed == generated_files()[path], "run: python -m tronlab.campaign.schema"


def test_page_lists_keys_with_type_limits_default_and_text() -> None:
    page = generated_files()[Path("docs/reference/campaign.md")]
    row = "| `camera.exposure_s` | number, more than 0, at most 60 | required | Exposure time. |"
    assert row in page
    assert "| `trajectory.kind: file` |" in page
    names = "`lambert` or `lommel_seeliger` or `lunar_lambert` or `hapke` or section"
    assert f"| `database.photometry` | `calibrated` or {names} | `lambert` |" in page
    assert "| `database.photometry.kind: hapke` |" in page
    assert "| `trajectory.start_trs_m` | 3 x number | required |" in page
    assert "| `world.faults[].at` | integer, at least 1 | required |" in page


def test_files_are_written_below_the_checkout(tmp_path: Path) -> None:
    write_generated_files(tmp_path)
    for path, text in generated_files().items():
        assert (tmp_path / path).read_text(encoding="utf-8") == text
