"""The operator at a terminal: asked to do by hand what no device can do."""

from tronlab.devices.protocols import OperatorTask
from tronlab.devices.readings import DeviceIdentity
from tronlab.devices.registry import DeviceContext

_INSTRUCTIONS: dict[OperatorTask, str] = {
    "place_board": "Put the calibration board in front of the model, where the rig file says.",
    "remove_board": "Take the calibration board away.",
}


class ConsoleOperator:
    """A person who reads the terminal and presses Enter when done."""

    def __init__(self, context: DeviceContext) -> None:
        self.name = context.name

    def connect(self) -> None:
        """Nothing to connect: the person sits there."""

    def close(self) -> None:
        """Nothing to close."""

    def identify(self) -> DeviceIdentity:
        """Give an identity that says it is a person."""
        return DeviceIdentity(maker="", model="operator", serial="", firmware="")

    def perform(self, task: OperatorTask) -> None:
        """Ask for the task and wait for Enter."""
        input(f"{_INSTRUCTIONS[task]} Press Enter when done. ")
