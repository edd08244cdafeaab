"""tronlab: test campaigns for optical navigation in a robot laboratory of the TRON kind."""

from importlib.metadata import version

__version__ = version("tronlab")
