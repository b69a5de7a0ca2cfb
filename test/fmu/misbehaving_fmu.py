"""An FMU of another make, with other names and units, that can misbehave (misbehaving.c)."""

import subprocess
import sys
import zipfile
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, tostring

from ehls_ros.fmu.library import headers

GOOD, CRASH, HANG, NOT_A_NUMBER, ERROR, EXIT = range(6)

VARIABLES = (
    ("u", "input", "mm"),
    ("F_ext", "input", "kN"),
    ("cylinder.x", "output", "mm"),
    ("cylinder.v", "output", "mm/s"),
    ("pA", "output", "bar"),
    ("pB", "output", "bar"),
    ("spool", "output", "mm"),
    ("misdeed", "parameter", ""),
)

MAP = {
    "inputs": {"valve_command": "u", "disturbance_force": {"variable": "F_ext", "factor": -1}},
    "outputs": {
        "position": "cylinder.x",
        "velocity": {"variable": "cylinder.v", "unit": "mm/s"},
        "load_pressure": {"variable": "pA", "minus": "pB"},
        "spool_position": "spool",
    },
}


def description():
    root = Element("fmiModelDescription", {"fmiVersion": "2.0", "modelName": "other", "guid": "{1}"})
    SubElement(root, "CoSimulation", {"modelIdentifier": "other"})
    units = SubElement(root, "UnitDefinitions")
    for unit in sorted({unit for _, _, unit in VARIABLES if unit}):
        SubElement(units, "Unit", {"name": unit})
    variables, structure = SubElement(root, "ModelVariables"), SubElement(root, "ModelStructure")
    listed = [SubElement(structure, "Outputs"), SubElement(structure, "InitialUnknowns")]
    for place, (name, causality, unit) in enumerate(VARIABLES):
        variability = "fixed" if causality == "parameter" else "continuous"
        own = {"name": name, "valueReference": str(place), "causality": causality, "variability": variability}
        numbers = ({"unit": unit} if unit else {}) | ({} if causality == "output" else {"start": "0"})
        SubElement(SubElement(variables, "ScalarVariable", own), "Real", numbers)
        for group in listed if causality == "output" else ():
            SubElement(group, "Unknown", {"index": str(place + 1)})
    return tostring(root, encoding="UTF-8", xml_declaration=True)


def write(folder: Path) -> Path:
    """Build the FMU and return its path."""
    library, path = folder / "other.so", folder / "other.fmu"
    source = Path(__file__).with_name("misbehaving.c")
    words = [sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-linux-gnu.2.17", "-shared", "-fPIC", "-O1"]
    subprocess.run([*words, "-fno-sanitize=all", "-I", str(headers("test")), "-o", str(library), str(source)], check=True)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", description())
        archive.write(library, "binaries/linux64/other.so")
    return path
