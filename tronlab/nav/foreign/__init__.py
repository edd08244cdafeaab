"""Navigation cores outside this process: programs, sockets, hosted Python; one wire protocol."""

from tronlab.nav.foreign.core import ForeignCore, open_core
from tronlab.nav.foreign.description import CoreDescription, describe_core

__all__ = ["CoreDescription", "ForeignCore", "describe_core", "open_core"]
