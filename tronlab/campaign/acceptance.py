"""What speaks against going on is refused, unless a person accepts it."""

from collections.abc import Callable
from dataclasses import dataclass, field

from tronlab.errors import CalibrationError, ChangedError


@dataclass
class Acceptance:
    """What a person lets pass, told by an option of the command line, and what that was."""

    is_given: bool
    warn: Callable[[str], None]
    """Told of everything that passes."""
    option: str = "--accept-calibration"
    accepted: list[str] = field(default_factory=list[str], init=False)
    """For the provenance of the dataset, one line each."""

    def let_pass(self, check: Callable[[], None]) -> None:
        """Do a check, and go on after its error if that was accepted beforehand.

        Raises:
            CalibrationError: Of the check, with the advice how to accept it.
            ChangedError: Likewise.
        """
        try:
            check()
        except (CalibrationError, ChangedError) as error:
            if not self.is_given:
                raise type(error)(
                    f"{error}\nor go on all the same, and the dataset says so: {self.option}"
                ) from None
            reason = str(error).partition("\n")[0].rstrip(";")
            self.accepted.append(reason)
            self.warn(f"accepted: {reason}")
