"""May the robot move now? Read from the controller's state; nothing here changes it."""

from drivers.kuka.backend import ControllerState, Refusal
from drivers.kuka.options import KukaOptions
from tronlab.errors import DeviceError, DeviceFaultError, LimitError, NotReadyError, SafetyError


def require_running(
    state: ControllerState, options: KukaOptions, *, device: str, call: str
) -> None:
    """Return if nothing stands against motion, before it and during it.

    Raises:
        SafetyError: Emergency stop pressed, or guard open.
        DeviceFaultError: A stop message is pending.
        NotReadyError: Drives off, another operating mode, or the robot program does not run.
    """
    if not state.is_emergency_stop_released:
        raise SafetyError(
            f"{call}: an emergency stop is pressed; make the cell safe and release it",
            device=device,
        )
    if not state.is_guard_closed:
        raise SafetyError(
            f"{call}: the guard is open; leave the cell, close and acknowledge it", device=device
        )
    if state.has_stop_message:
        raise DeviceFaultError(
            f"{call}: a stop message is pending; read and acknowledge it at the pendant",
            device=device,
            code=state.error,
        )
    if not state.are_drives_on:
        raise _not_ready(f"{call}: the drives are off; switch them on", device)
    if state.mode not in options.operating_modes:
        raise _not_ready(
            f"{call}: operating mode is {state.mode}, allowed {', '.join(options.operating_modes)};"
            " turn the key switch",
            device,
        )
    if not state.is_program_active:
        raise _not_ready(f"{call}: the robot program does not run; start it", device)


def require_ready(state: ControllerState, options: KukaOptions, *, device: str, call: str) -> None:
    """Return if a motion may be begun.

    Raises:
        SafetyError: As ``require_running``, as the two below.
        DeviceFaultError: A stop message is pending.
        NotReadyError: Also with override 0, or while still busy.
        LimitError: The program override is above what is allowed.
    """
    require_running(state, options, device=device, call=call)
    if state.override_pct > options.max_override_pct:
        raise LimitError(
            f"{call}: program override is {state.override_pct} %, allowed up to"
            f" {options.max_override_pct} %; turn it down at the pendant",
            device=device,
        )
    if state.override_pct == 0:
        raise _not_ready(f"{call}: program override is 0 %; turn it up at the pendant", device)
    if state.is_moving or state.accepted_id != state.done_id:
        raise _not_ready(
            f"{call}: the robot is still busy with command {state.accepted_id}", device
        )


def refused(state: ControllerState, *, device: str, call: str) -> DeviceError:
    """Make the error of a command that the controller did not carry out."""
    code = state.error
    if code in (Refusal.AXIS_LIMIT, Refusal.RAIL_LIMIT):
        what = "the rail" if code == Refusal.RAIL_LIMIT else "an axis"
        return LimitError(
            f"{call}: the controller refuses: {what} would leave its software limits (code {code});"
            " its limits and those of the rig file differ",
            device=device,
        )
    if code == Refusal.NOT_READY:
        return NotReadyError(f"{call}: the controller is not ready", device=device, code=code)
    reasons: dict[int, str] = {
        Refusal.UNKNOWN_KIND: "the controller does not know this kind of command",
        Refusal.HELD: "held before the target was reached",
        Refusal.MOTION_FAILED: "the motion failed; see the pendant",
    }
    what = reasons.get(code, "the controller reports an unknown error")
    return DeviceFaultError(f"{call}: {what}", device=device, code=code)


def _not_ready(message: str, device: str) -> NotReadyError:
    return NotReadyError(message, device=device, code=Refusal.NOT_READY)
