"""A stage store in memory."""

from tronlab.nav.stages import Arrays


class DictStore:
    """Keeps everything, by stage and key."""

    def __init__(self) -> None:
        self.kept: dict[tuple[str, str], Arrays] = {}

    def load(self, stage: str, key: str) -> Arrays | None:
        return self.kept.get((stage, key))

    def save(self, stage: str, key: str, arrays: Arrays) -> None:
        self.kept[stage, key] = arrays
