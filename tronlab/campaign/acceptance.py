"""A calibration record that should not serve is refused, unless a person accepts it."""

from collections.abc import Callable
from dataclasses import dataclass, field

from tronlab.errors import CalibrationError


@dataclass
class Acceptance:
    """What a person lets pass, told by ``--accept-calibration``, and what that was."""

    is_given: bool
    warn: Callable[[str], None]
    """Told of everything that passes."""
    accepted: list[str] = field(default_factory=list[str], init=False)
    """For the provenance of the dataset, one line each."""

    def let_pass(self, check: Callable[[], None]) -> None:
        """Do a check, and go on after its error if that was accepted beforehand.

        Raises:
            CalibrationError: Of the check, with the advice how to accept it.
        """
        try:
            check()
        except CalibrationError as error:
            if not self.is_given:
                raise CalibrationError(
                    f"{error}\nor use it all the same, and the dataset says so:"
                    " --accept-calibration"
                ) from None
            reason = str(error).partition("\n")[0].rstrip(";")
            self.accepted.append(reason)
            self.warn(f"accepted: {reason}")
