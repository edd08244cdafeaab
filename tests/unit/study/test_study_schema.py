from pathlib import Path

import pytest

from tronlab.study.schema import generated_files

REPOSITORY = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize("path", generated_files(), ids=str)
def test_committed_file_is_fresh(path: Path) -> None:
    committed = (REPOSITORY / path).read_text(encoding="utf-8")
    assert committed == generated_files()[path], "run: python -m tronlab.study.schema"
