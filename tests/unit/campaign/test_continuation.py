import pytest

from tronlab.campaign.continuation import parse_shot_ids
from tronlab.errors import ConfigError


def test_a_list_of_shots_as_people_write_it() -> None:
    assert parse_shot_ids("3, 7-9,8") == (3, 7, 8, 9)


@pytest.mark.parametrize("text", ["", "x", "3,", "3-", "-3", "1.5", "9-7", "1-99999999999"])
def test_what_is_no_list_of_shots(text: str) -> None:
    with pytest.raises(ConfigError, match=r"--shots .*(write 3,7-9|expected numbers that go up)"):
        parse_shot_ids(text)
