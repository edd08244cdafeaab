"""Reading values from an HDF5 file; whatever is wrong with it becomes one clear error."""

from pathlib import Path
from typing import Any

import h5py

from tronlab.errors import DatasetError, IntegrityError


class Hdf5Reader:
    """Groups, datasets and attributes of one file by their path."""

    def __init__(self, path: Path, file: h5py.File) -> None:
        """Take over an open file.

        Args:
            path: Of the file, for messages.
            file: Open for reading; closed by ``close``.
        """
        self.path = path
        self._file = file
        self._objects: dict[str, Any] = {}

    def __contains__(self, path: str) -> bool:
        """Tell whether there is a group or dataset."""
        self._check_open()
        return path in self._objects or path in self._file  # HDF5 itself is slow to answer

    def close(self) -> None:
        """Close the file; may be called twice."""
        self._file.close()

    def read(self, path: str, where: Any = ()) -> Any:
        """Read a dataset, or the part of it that ``where`` indexes.

        Raises:
            IntegrityError: It is missing or damaged.
        """
        dataset = self.at(path)
        try:
            return dataset[where]
        except (OSError, RuntimeError, ValueError, IndexError, TypeError) as error:
            raise IntegrityError(
                f"{self.path}: {path} cannot be read, the file is damaged (HDF5: {error})"
            ) from error

    def text(self, path: str) -> str:
        """Read a text.

        Raises:
            IntegrityError: It is missing, damaged, or no text.
        """
        value = self.read(path)
        return self.decoded(path, value) if isinstance(value, bytes) else str(value)

    def decoded(self, where: str, text: bytes) -> str:
        """Decode a text that was read at some place.

        Raises:
            IntegrityError: It is no text.
        """
        try:
            return text.decode()
        except UnicodeDecodeError as error:
            raise IntegrityError(
                f"{self.path}: {where} is damaged: {text[:40]!r} is not text"
            ) from error

    def attributes(self, path: str) -> dict[str, Any]:
        """Read the attributes of a group or dataset besides its NeXus class.

        Raises:
            IntegrityError: It is missing or damaged.
        """
        item = self.at(path)
        try:
            attributes = dict(item.attrs)
        except (OSError, RuntimeError, UnicodeDecodeError, KeyError, ValueError) as error:
            raise IntegrityError(
                f"{self.path}: the attributes of {path} are damaged (HDF5: {error})"
            ) from error
        attributes.pop("NX_class", None)
        return attributes

    def texts(self, path: str) -> dict[str, str]:
        """Read the attributes of a group as texts, besides its NeXus class.

        Raises:
            IntegrityError: It is missing or damaged.
        """
        return {name: str(value) for name, value in self.attributes(path).items()}

    def names(self, path: str) -> list[str]:
        """Give what is in a group.

        Raises:
            IntegrityError: It is missing or damaged.
        """
        group = self.at(path)
        try:
            return list(group)
        except (OSError, RuntimeError, TypeError) as error:
            raise IntegrityError(f"{self.path}: {path} is damaged (HDF5: {error})") from error

    def at(self, path: str) -> Any:
        """Give a group or dataset.

        Raises:
            DatasetError: The file is closed.
            IntegrityError: It is missing or damaged.
        """
        self._check_open()
        try:
            if path not in self._objects:
                self._objects[path] = self._file[path]
            return self._objects[path]
        except (KeyError, OSError, RuntimeError) as error:
            raise IntegrityError(
                f"{self.path}: {path} is missing or damaged (HDF5: {error})"
            ) from error

    def _check_open(self) -> None:
        if not self._file:
            raise DatasetError(f"{self.path}: is closed")
