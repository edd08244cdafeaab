"""Foreign cores that are closed after the test."""

from collections.abc import Callable, Generator

import pytest
from plain_cores import CAMERA, reference

from tronlab.nav.core import CoreContext
from tronlab.nav.foreign import ForeignCore, open_core
from tronlab.nav.specs import CoreSpec


@pytest.fixture
def context() -> CoreContext:
    return CoreContext(CAMERA, (reference(4), reference(9)))


@pytest.fixture
def opened(context: CoreContext) -> Generator[Callable[..., ForeignCore]]:
    """``opened(spec, limit_s=...)`` opens a core that is closed at the end of the test."""
    cores: list[ForeignCore] = []

    def make(spec: CoreSpec, *, limit_s: float = 20.0, start_limit_s: float = 20.0) -> ForeignCore:
        cores.append(open_core(spec, context, limit_s=limit_s, start_limit_s=start_limit_s))
        return cores[-1]

    yield make
    for core in cores:
        core.close()
