"""What a tracker says without being asked."""

import time
from dataclasses import dataclass

from drivers.leica.codes import event_text
from drivers.leica.status import meaning_of


@dataclass(frozen=True, slots=True)
class Notice:
    """A status event, or an error that answers no command."""

    is_error: bool
    code: int
    """Number of the event or of the error; any, also one that this driver does not know."""
    text: str
    time_s: float
    """When it was read, seconds since 1970 UTC."""

    @classmethod
    def of_event(cls, number: int) -> "Notice":
        """Make the notice of an event that has just come."""
        return cls(False, number, event_text(number), time.time())

    @classmethod
    def of_error(cls, status: int) -> "Notice":
        """Make the notice of an error that has just come."""
        return cls(True, status, meaning_of(status), time.time())
