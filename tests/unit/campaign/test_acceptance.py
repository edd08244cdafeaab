import pytest

from tronlab.campaign.acceptance import Acceptance
from tronlab.errors import CalibrationError, ConfigError


def expired() -> None:
    raise CalibrationError("record a.json: expired;\nmeasure it anew")


def test_what_should_not_serve_is_refused_with_the_advice_how_to_accept_it() -> None:
    acceptance = Acceptance(is_given=False, warn=lambda text: None)
    acceptance.let_pass(lambda: None)
    with pytest.raises(CalibrationError, match=r"expired;\nmeasure it anew\n.*--accept-calib"):
        acceptance.let_pass(expired)
    assert acceptance.accepted == []


def test_what_is_accepted_is_told_and_noted() -> None:
    told: list[str] = []
    acceptance = Acceptance(is_given=True, warn=told.append)
    acceptance.let_pass(lambda: None)
    acceptance.let_pass(expired)
    assert acceptance.accepted == ["record a.json: expired"]
    assert told == ["accepted: record a.json: expired"]


def test_other_errors_are_never_accepted() -> None:
    def broken() -> None:
        raise ConfigError("no such file")

    with pytest.raises(ConfigError):
        Acceptance(is_given=True, warn=lambda text: None).let_pass(broken)
