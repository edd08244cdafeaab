"""What a core's answers depend on, as a text that changes when it does."""

import hashlib
import os
import shutil
import sys
import sysconfig
from collections.abc import Iterable, Sequence
from os.path import isfile
from pathlib import Path

_SOURCES = {".py", ".so", ".pyd"}
_OWN_PACKAGE = "tronlab"


def digest_of_command(arguments: Sequence[str]) -> str:
    """Give a digest of a command: program, arguments, and the files that these name.

    A file is named by an argument, or behind the equals sign of one such as ``--cfg=x.yaml``.
    What a program reads beyond that it must say itself, as ``identity`` of its hello.
    """
    program = shutil.which(arguments[0])
    named = [text.partition("=")[2] or text for text in arguments[1:]]
    paths = [Path(text) for text in (*([program] if program else []), *arguments[1:], *named)]
    return _digest(arguments, (path for path in paths if _is_readable(path)))


def digest_of_sources(*module_names: str) -> str:
    """Give a digest of the code behind imported modules.

    It is that of their whole top-level packages, of what is imported of tronlab, and of every other
    module imported so far that is not installed: scripts side by side import each other. Installed
    packages count by the environment, which is the user's to keep.
    """
    tops = {name.partition(".")[0] for name in module_names}
    folders = {path for top in tops for path in getattr(sys.modules[top], "__path__", ())}
    paths = {path for folder in folders for path in Path(folder).rglob("*")}
    installed = tuple(Path(path) for path in _installed_folders())
    for name, module in tuple(sys.modules.items()):
        if file := getattr(module, "__file__", None):
            path = Path(file)
            is_own = name.partition(".")[0] in {*tops, _OWN_PACKAGE}
            if is_own or not any(folder in path.parents for folder in installed):
                paths.add(path)
    sources = (path for path in sorted(paths) if path.suffix in _SOURCES and _is_readable(path))
    return _digest(module_names, sources)


def _installed_folders() -> tuple[str, ...]:
    paths = sysconfig.get_paths()
    return paths["stdlib"], paths["platstdlib"], paths["purelib"], paths["platlib"]


def _is_readable(path: Path) -> bool:
    # Not Path.is_file: an argument may be too long for a path, or have a zero in it.
    return isfile(path) and os.access(path, os.R_OK)


def _digest(words: Iterable[str], paths: Iterable[Path]) -> str:
    digest = hashlib.blake2b(digest_size=20)
    for word in words:
        digest.update(word.encode(errors="surrogateescape") + b"\0")
    for path in paths:
        with path.open("rb") as file:
            digest.update(hashlib.file_digest(file, "sha256").digest())
    return digest.hexdigest()
