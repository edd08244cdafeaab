"""The commands ``tronlab twin``: the simulated laboratory on the wire."""

from collections.abc import Generator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from tronlab.campaign.rig import Rig
    from tronlab.twin.server import RemoteState

twin = typer.Typer(
    no_args_is_help=True, help="The simulated laboratory behind real protocols, on loopback."
)

RigFile = Annotated[Path, typer.Argument(metavar="RIG.yaml", help="Rig file.")]
_LOOK_S = 0.5


@twin.command()
def up(
    rig: RigFile,
    seed: Annotated[int, typer.Option(min=0, help="Seed of measurement noise.")] = 0,
    session: Annotated[
        str, typer.Option(help="What it runs for; another session has other noise.")
    ] = "run",
) -> None:
    """Start the simulators of a rig over one simulated laboratory; Ctrl-C stops them."""
    import signal
    import time

    from tronlab.campaign.rig import load_rig
    from tronlab.campaign.simulators import simulator_modules
    from tronlab.twin.fleet import Fleet

    def tell(text: str) -> None:
        typer.echo(text, err=True)

    # A service manager's way to say Ctrl-C.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    loaded = load_rig(rig)
    modules = simulator_modules(loaded)
    loaded.open_devices(seed)  # so that a mistake in an option is told with its line
    try:
        with (
            _serve_world(loaded) as address,
            closing(
                Fleet(
                    modules, rig_path=rig, world=address, seed=seed, session=session, announce=tell
                )
            ) as fleet,
        ):
            typer.echo(f"{'world':20} {address[0]}:{address[1]}")
            for device in fleet.addresses:
                typer.echo(f"{device.device:20} {device}")
            tell("ready; Ctrl-C stops the simulated laboratory")
            while True:
                time.sleep(_LOOK_S)
                fleet.check_alive()
    except KeyboardInterrupt:
        tell("stopped")


@twin.command()
def fault(
    rig: RigFile,
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="Fault; without one, all are listed.")
    ] = None,
    times: Annotated[
        int | None, typer.Option(min=1, help="How often it strikes (default: until cleared).")
    ] = None,
    clear: Annotated[bool, typer.Option("--clear", help="End the fault.")] = False,
) -> None:
    """Have a device of a running simulated laboratory fail, to see what a campaign does."""
    from tronlab.campaign.rig import load_rig
    from tronlab.campaign.simulators import simulator_faults
    from tronlab.errors import ConfigError
    from tronlab.twin.state import FOR_EVER

    loaded = load_rig(rig)
    faults = simulator_faults(loaded)
    if name is None:
        if clear or times is not None:
            raise ConfigError("name the fault that --clear or --times is for")
        for known, what in faults.items():
            typer.echo(f"{known:28} {what}")
        return
    if name not in faults:
        raise ConfigError(f"no fault '{name}'; faults: {', '.join(faults)}")
    if clear and times is not None:
        raise ConfigError("--clear ends a fault: leave out --times")
    state = _running(loaded)
    try:
        state.arm(name, times=0 if clear else times or FOR_EVER)
    finally:
        state.close()
    typer.echo(f"{name}: {'cleared' if clear else 'armed'}")


@twin.command()
def door(
    rig: RigFile,
    position: Annotated[str, typer.Argument(metavar="open|closed", help="What to do with it.")],
) -> None:
    """Open or close the door of a running simulated laboratory."""
    from tronlab.campaign.rig import load_rig
    from tronlab.errors import ConfigError

    if position not in {"open", "closed"}:
        raise ConfigError(f"'{position}': a door is 'open' or 'closed'")
    state = _running(load_rig(rig))
    try:
        state.change(is_door_closed=position == "closed")
    finally:
        state.close()
    typer.echo(f"the door is {position}")


def _running(rig: "Rig") -> "RemoteState":
    from tronlab.campaign.simulators import world_address
    from tronlab.twin.server import RemoteState

    return RemoteState(*world_address(rig))


@contextmanager
def _serve_world(rig: "Rig") -> Generator[tuple[str, int]]:
    """Serve the state of the rig's simulated laboratory, and give host and port."""
    from tronlab.campaign.simulators import world_address
    from tronlab.errors import ConfigError
    from tronlab.twin.server import StateServer
    from tronlab.twin.state import LocalState
    from tronlab.twin.world import initial_state

    setup = rig.world_setup()
    if setup is None:
        raise ConfigError("required key is missing", path=rig.path, key="world")
    host, port = world_address(rig)
    server = StateServer(LocalState(initial_state(setup)), host=host, port=port)
    try:
        yield server.address
    finally:
        server.close()
