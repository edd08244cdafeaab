"""What goes onto the controller: the XML against driver and simulator, the KRL against the XML."""

import re
import xml.etree.ElementTree as ET
from itertools import pairwise
from pathlib import Path

import pytest

import drivers.kuka
from drivers.kuka import eki as driver_eki
from drivers.kuka import kvp_backend as driver_kvp
from drivers.kuka.simulator import eki as simulator_eki
from drivers.kuka.simulator.controller import Controller
from drivers.kuka.simulator.scene import EmptyScene
from drivers.kuka.simulator.tags import DocumentReader
from drivers.kuka.simulator.variables import Variables
from tronlab.twin.state import ArmedFaults

FOLDER = Path(drivers.kuka.__file__).parent / "controller"
SOURCES = sorted(FOLDER.glob("*.src"))
DATA = sorted(FOLDER.glob("*.dat"))
KRL = [*SOURCES, *DATA]
BLOCKS = {
    "DEF": "END",
    "DEFFCT": "ENDFCT",
    "DEFDAT": "ENDDAT",
    "IF": "ENDIF",
    "SWITCH": "ENDSWITCH",
    "LOOP": "ENDLOOP",
    "WHILE": "ENDWHILE",
    "FOR": "ENDFOR",
    "REPEAT": "UNTIL",
}
OF_THE_CONTROLLER = {"BAS", "IR_STOPM", "INVERSE", "SEC", "AND", "OR", "NOT"} | {
    f"EKI_{name}"
    for name in (
        "CHECKBUFFER",
        "CLEAR",
        "GETINT",
        "GETREAL",
        "INIT",
        "OPEN",
        "SEND",
        "SETINT",
        "SETREAL",
    )
}
SET_BY_THE_PROGRAMS = (
    *("ADVANCE", "TOOL", "BASE", "LOAD", "IPO_MODE", "ORI_TYPE", "FLAG", "TIMER", "TIMER_STOP"),
    *("VEL_AXIS", "ACC_AXIS", "VEL_EXTAX", "ACC_EXTAX", "VEL", "ACC"),
)
LONGEST_NAME = 24
WRITTEN_AND_READ = ("SEQ", "CMD", "AXIS", "POS", "VEL", "ACC", "ACK", "DONE", "ERR")


def name_of(path: Path) -> str:
    return path.name


def code(path: Path) -> list[str]:
    """Give the statements in upper case, without comments, strings kept as they are."""
    lines = [re.sub(r";.*", "", line).strip() for line in path.read_text("ascii").splitlines()]
    return [line for line in lines if line and not line.startswith("&")]


def text_of(*paths: Path) -> str:
    return "\n".join(line for path in paths for line in code(path))


def strip_strings(text: str) -> str:
    return re.sub(r'"[^"]*"', '""', text)


def configuration(name: str) -> ET.Element:
    return ET.parse(FOLDER / name).getroot()  # noqa: S314


def elements(name: str, direction: str) -> dict[str, ET.Element]:
    found = configuration(name).findall(f"{direction}/XML/ELEMENT")
    tags = {element.get("Tag"): element for element in found}
    assert len(tags) == len(found)
    return tags


def tags_of(root: str, table: dict[str, tuple[str, ...]]) -> list[str]:
    return [
        f"{root}/{child}/@{name}" if child else f"{root}/@{name}"
        for child, names in table.items()
        for name in names
    ]


def globals_declared() -> dict[str, str]:
    """Give every global of the program, and its type."""
    pattern = re.compile(r"DECL GLOBAL (\w+) (\w+)")
    return {name: kind for kind, name in pattern.findall(text_of(FOLDER / "lab_globals.dat"))}


@pytest.mark.parametrize(("name", "port"), [("LabCommand.xml", "54600"), ("LabState.xml", "54601")])
def test_channel_is_a_tcp_server_of_the_submit_interpreter(name, port):
    root = configuration(name)
    assert root.tag == "ETHERNETKRL"
    assert root.findtext("CONFIGURATION/EXTERNAL/TYPE") == "Client"
    assert root.findtext("CONFIGURATION/INTERNAL/ENVIRONMENT") == "Submit"
    assert root.findtext("CONFIGURATION/INTERNAL/PROTOCOL") == "TCP"
    assert root.findtext("CONFIGURATION/INTERNAL/PORT") == port


def test_commands_have_the_elements_the_driver_sends_and_the_simulator_reads():
    received = elements("LabCommand.xml", "RECEIVE")
    whole = received.pop("RobotCommand")
    assert whole.get("Set_Flag")
    assert list(received) == tags_of("RobotCommand", driver_eki.COMMAND_TAGS)
    kinds = {tag: element.get("Type") for tag, element in received.items()}
    assert {tag for tag, kind in kinds.items() if kind == "INT"} == set(simulator_eki.INT_TAGS)
    assert {tag for tag, kind in kinds.items() if kind == "REAL"} == set(simulator_eki.REAL_TAGS)
    assert not elements("LabCommand.xml", "SEND")


def test_states_have_the_elements_the_driver_reads_and_the_simulator_sends():
    sent = elements("LabState.xml", "SEND")
    assert list(sent) == tags_of("RobotState", driver_eki.STATE_TAGS)
    controller = Controller(EmptyScene(), ArmedFaults())
    controller.close()
    (told,) = DocumentReader().feed(simulator_eki.state_document(controller.state, 1))
    assert list(told) == list(sent)
    assert not elements("LabState.xml", "RECEIVE")


def test_krl_reads_every_element_once_and_by_its_type():
    reads = re.findall(r'EKI_GET(\w+)\("LabCommand","([^"]+)"', text_of(FOLDER / "lab_eki.src"))
    declared = elements("LabCommand.xml", "RECEIVE")
    declared.pop("RobotCommand")
    assert [(kind, tag) for kind, tag in reads] == [
        (element.get("Type"), tag) for tag, element in declared.items()
    ]


def test_krl_looks_at_the_status_of_every_element_it_reads():
    lines = code(FOLDER / "lab_eki.src")
    for line, following in pairwise(lines):
        if "EKI_GET" in line:
            assert following == "NOTE_STATUS(RET)", line


def test_krl_sets_every_element_before_it_sends():
    text = text_of(FOLDER / "lab_eki.src")
    set_tags = re.findall(r'EKI_SET(?:INT|REAL)\("LabState","([^"]+)"', text)
    assert set_tags == list(elements("LabState.xml", "SEND"))
    assert text.index('EKI_SEND("LabState","RobotState")') > text.rindex("EKI_SETINT")


def test_flags_of_the_xml_are_those_of_the_krl():
    text = text_of(FOLDER / "lab_globals.dat")
    flags = {name: int(n) for name, n in re.findall(r"(LAB_F_\w+)=(\d+)", text)}
    command, state = configuration("LabCommand.xml"), configuration("LabState.xml")

    def alive(root: ET.Element) -> int:
        return int(root.find("CONFIGURATION/INTERNAL/ALIVE").get("Set_Flag"))

    came = int(elements("LabCommand.xml", "RECEIVE")["RobotCommand"].get("Set_Flag"))
    assert flags == {
        "LAB_F_COMMAND_ALIVE": alive(command),
        "LAB_F_COMMAND_CAME": came,
        "LAB_F_STATE_ALIVE": alive(state),
    }
    assert len(set(flags.values())) == 3
    assert all(1 <= flag <= 1025 for flag in flags.values())


def test_every_global_is_declared_once_and_used():
    declared = globals_declared()
    assert len(declared) == text_of(FOLDER / "lab_globals.dat").count("DECL")
    used = set(re.findall(r"\bLAB_\w+", strip_strings(text_of(*SOURCES))))
    routines = set(re.findall(r"DEF(?:FCT \w+)? (\w+)\(", text_of(*SOURCES)))
    assert used - routines == set(declared)


def test_variables_the_driver_uses_are_declared_with_their_types():
    declared = globals_declared()
    names = [getattr(driver_kvp, name) for name in WRITTEN_AND_READ]
    kinds = [declared[name] for name in names]
    assert kinds == ["INT", "INT", "E6AXIS", "E6POS", "REAL", "REAL", "INT", "INT", "INT"]


def test_simulator_has_the_variables_of_the_pc():
    controller = Controller(EmptyScene(), ArmedFaults())
    controller.close()
    variables = Variables(controller)
    text = (FOLDER / "lab_globals.dat").read_text("ascii")
    of_the_pc = text[text.index(";FOLD Written by the PC") : text.index(";FOLD Between")]
    names = re.findall(r"DECL GLOBAL \w+ (\w+)", of_the_pc)
    assert len(names) == 11
    assert all(variables.read(name) for name in names)


@pytest.mark.parametrize("path", KRL, ids=name_of)
def test_blocks_are_closed_in_turn(path):
    open_blocks: list[str] = []
    for line in code(path):
        words = re.findall(r"\w+", strip_strings(line))
        word = words[1] if words[0] == "GLOBAL" and words[1] in BLOCKS else words[0]
        if word in BLOCKS:
            open_blocks.append(word)
        elif word in BLOCKS.values():
            assert open_blocks, line
            assert BLOCKS[open_blocks.pop()] == word, line
        elif word in ("CASE", "DEFAULT"):
            assert open_blocks[-1] == "SWITCH", line
        elif word == "ELSE":
            assert open_blocks[-1] == "IF", line
        if word == "IF":
            assert line.endswith(" THEN"), line
    assert open_blocks == []


@pytest.mark.parametrize("path", KRL, ids=name_of)
def test_folds_and_brackets_are_closed(path):
    text = path.read_text("ascii")
    assert text.count(";FOLD") == text.count(";ENDFOLD")
    for line in code(path):
        assert line.count("(") == line.count(")"), line
        assert line.count("{") == line.count("}"), line
        assert line.count('"') % 2 == 0, line


@pytest.mark.parametrize("path", KRL, ids=name_of)
def test_names_are_short_enough_and_files_are_named_as_their_contents(path):
    lines = code(path)
    assert all(len(name) <= LONGEST_NAME for name in re.findall(r"\w+", text_of(path)))
    assert re.fullmatch(rf"DEF(DAT)? {path.stem.upper()}(\( \)| PUBLIC)?", lines[0])
    assert path.read_text("ascii").splitlines()[0].startswith("&ACCESS")


def test_every_routine_called_is_there_with_as_many_arguments():
    text = strip_strings(text_of(*SOURCES))
    routines = {
        name: len([p for p in parameters.split(",") if p.strip()])
        for name, parameters in re.findall(r"DEF(?:FCT \w+)? (\w+)\(([^)]*)\)", text)
    }
    assert len(routines) == len(re.findall(r"^(?:GLOBAL )?DEF(?:FCT)? ", text, re.MULTILINE))
    calls = re.findall(r"(?<!DEF )(?<!DEFFCT INT )(?<!DEFFCT BOOL )\b([A-Z_]\w*)\(([^()]*)\)", text)
    for name, arguments in calls:
        if name in routines and not re.search(r":IN", arguments):
            n = len([a for a in arguments.split(",") if a.strip()])
            assert n == routines[name], name
    called = {name for name, _ in calls} | set(re.findall(r"DO (\w+)\(", text))
    by_the_lab = {"LAB_WATCH_INIT", "LAB_WATCH_CYCLE", "LAB_EKI_INIT", "LAB_EKI_CYCLE"}
    assert called - OF_THE_CONTROLLER <= set(routines)
    assert set(routines) - called <= by_the_lab | {path.stem.upper() for path in SOURCES}


def test_rail_is_shut_until_a_lab_opens_it():
    text = text_of(FOLDER / "lab_globals.dat")
    assert "LAB_RAIL_LOW=0.0" in text
    assert "LAB_RAIL_HIGH=0.0" in text


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_safety_and_override_are_only_read(path):
    assigned = set(re.findall(r"^(\$\w+)[^=<>]*=[^=]", text_of(path), re.MULTILINE))
    assert assigned <= {f"${name}" for name in SET_BY_THE_PROGRAMS}
