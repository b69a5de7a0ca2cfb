"""FMUs of the paper's rig and its law: export, size, speed, and Table 3 with two FMUs against our own run.

    make setup WITH=fmu
    python -m benchmarks.fmu
    python -m benchmarks.fmu --reference-fmus FOLDER        # a checkout of github.com/modelica/Reference-FMUs
    python -m benchmarks.fmu --python-fmu                   # with PythonFMU3, installed beside

With the reference FMUs' importer, the same steps run in a process without environment and, if wine is installed, with the
library for Windows; their FMU Feedthrough is stepped as a foreign plant.
"""

import re
import shutil
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from fmpy import extract, read_model_description
from fmpy.simulation import instantiate_fmu, simulate_fmu
from fmpy.validation import validate_fmu

from benchmarks.common import ROOT, parser_of
from ehls_ros.arrays import Array
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.loop import run_in_process, sampled
from ehls_ros.experiments.spec import Spec, load_rig
from ehls_ros.fmu.archive import FOLDERS, fmu
from ehls_ros.fmu.control_model import law_model
from ehls_ros.fmu.foreign_plant import ForeignPlant
from ehls_ros.fmu.plant_map import map_from_mapping
from ehls_ros.fmu.plant_model import plant_model
from ehls_ros.physics.rig import SENSED
from ehls_ros.reproduction import paper
from ehls_ros.reproduction.cases import case

PERIOD = 1e-3

STEPS = 20_000

VERSIONS = ("2.0", "3.0")


class Stepped:
    """An FMU in FMPy, with its variables by name."""

    def __init__(self, path: Path, unpacked: str) -> None:
        """Instantiate and initialise it."""
        described = read_model_description(unpacked)
        third = described.fmiVersion == "3.0"
        self.references = {variable.name: variable.valueReference for variable in described.modelVariables}
        self.fmu = instantiate_fmu(unpacked, described, "CoSimulation")
        self.set = self.fmu.setFloat64 if third else self.fmu.setReal
        self.get = self.fmu.getFloat64 if third else self.fmu.getReal
        if not third:
            self.fmu.setupExperiment(startTime=0.0)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()

    def numbers(self, *names: str) -> list[int]:
        """Return the value references of some variables."""
        return [self.references[name] for name in names]


@contextmanager
def stepped(path: Path) -> Iterator[Stepped]:
    """Unpack and run an FMU."""
    unpacked = str(extract(str(path)))
    try:
        made = Stepped(path, unpacked)
        yield made
        made.fmu.terminate()
        made.fmu.freeInstance()
    finally:
        shutil.rmtree(unpacked, ignore_errors=True)


def cell_errors(spec: Spec, plant_path: Path, law_path: Path) -> tuple[float, float]:
    """Return the largest differences of force and command between two FMUs and our own run, relative to the largest value."""
    wanted = run_in_process(spec)
    reference = sampled(spec.reference, PERIOD).rows(0, spec.cycles)
    pushed = np.column_stack([wanted["disturbance_force_n"], wanted["disturbance_force_rate_n_s"]])
    found = np.empty((spec.cycles, 2))
    with stepped(plant_path) as plant, stepped(law_path) as law:
        sensed, readings = plant.numbers(*SENSED), law.numbers(*SENSED)
        followed = law.numbers("reference", "reference_rate", "reference_acceleration")
        given, [answer] = (
            plant.numbers("valve_command", "disturbance_force", "disturbance_force_rate"),
            law.numbers("valve_command"),
        )
        for cycle in range(spec.cycles):
            measured = list(plant.get(sensed))
            law.set(readings + followed, measured + reference[cycle].tolist())
            law.fmu.doStep(cycle * PERIOD, PERIOD)
            command = law.get([answer])[0]
            found[cycle] = measured[SENSED.index("force")], command
            plant.set(given, [command, *pushed[cycle].tolist()])
            plant.fmu.doStep(cycle * PERIOD, PERIOD)
    own = np.column_stack([wanted["force_n"], wanted["valve_command_m"]])
    force, command = np.abs(found - own).max(axis=0) / np.abs(own).max(axis=0)
    return float(force), float(command)


def command_of(step: int) -> float:
    """Return the command of the importers' comparison [m]."""
    return 1e-3 if step % 200 < 100 else -0.8e-3


def stepping_time(path: Path, *, periods: int = 1, alone: bool = False) -> float:
    """Return the least time of a step in FMPy over blocks of a hundred [s].

    Args:
        path: the FMU.
        periods: sample periods in a step.
        alone: whether the command stays and nothing is read.
    """
    times, number = [], 0
    with stepped(path) as plant:
        [command], [force] = plant.numbers("valve_command"), plant.numbers("force")
        for _ in range(STEPS // 100):
            begun = time.perf_counter()
            for number in range(number, number + 100):  # noqa: B020 - goes on
                if not alone:
                    plant.set([command], [command_of(number)])
                plant.fmu.doStep(number * periods * PERIOD, periods * PERIOD)
                if not alone:
                    plant.get([force])
            times.append((time.perf_counter() - begun) / 100)
            number += 1
    return min(times)


def last_outputs(path: Path, steps: int) -> Array:
    """Return the readings in FMPy after the commands of :func:`command_of`."""
    with stepped(path) as plant:
        [command] = plant.numbers("valve_command")
        for step in range(steps):
            plant.set([command], [command_of(step)])
            plant.fmu.doStep(step * PERIOD, PERIOD)
        return np.array(plant.get(plant.numbers(*SENSED)))


def importer(sources: Path, system: str, folder: Path) -> Path:
    """Build the importer of the reference FMUs with our main program."""
    target = {"linux": "x86_64-linux-gnu.2.17", "windows": "x86_64-windows-gnu"}[system]
    made = folder / ("importer" if system == "linux" else "importer.exe")
    for header, own in (("Windows.h", "windows.h"), ("Shlwapi.h", "shlwapi.h")):
        (folder / header).write_text(f"#include <{own}>\n", encoding="utf-8")
    shims = ["-I", str(folder)] if system == "windows" else []
    words = [sys.executable, "-m", "ziglang", "cc", "-target", target, "-O1", "-fno-sanitize=all", "-w", *shims]
    words += ["-I", str(sources / "include"), "-o", str(made), str(ROOT / "benchmarks" / "fmu_importer.c")]
    words += [str(sources / "src" / name) for name in ("FMI.c", "FMI2.c", "FMI3.c")]
    subprocess.run([*words, "-ldl" if system == "linux" else "-lshlwapi"], check=True)
    return made


def imported(command: list[str], path: Path, version: str, system: str, steps: int, folder: Path) -> Array:
    """Return the readings in the reference FMUs' importer, run without environment variables of this process."""
    with zipfile.ZipFile(path) as archive:
        name = next(entry for entry in archive.namelist() if FOLDERS[version][system] in entry)
        library = archive.extract(name, folder / version)
    described = read_model_description(str(path))
    references = {variable.name: str(variable.valueReference) for variable in described.modelVariables}
    words = [*command, version, library, described.guid, references["valve_command"], str(steps)]
    environment = {} if system == "linux" else {"WINEDEBUG": "-all", "HOME": str(folder), "PATH": "/usr/bin:/bin"}
    words += [references[signal] for signal in SENSED]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
    return np.array([float.fromhex(line) for line in done.stdout.split()])


def feedthrough(sources: Path, folder: Path) -> None:
    """Step the reference FMU Feedthrough as a foreign plant."""
    for version in VERSIONS:
        model = sources / "Feedthrough"
        library, path = folder / "Feedthrough.so", folder / f"feedthrough_{version}.fmu"
        words = [sys.executable, "-m", "ziglang", "cc", "-target", "x86_64-linux-gnu.2.17", "-shared", "-fPIC", "-O1", "-w"]
        words += [
            "-fno-sanitize=all",
            f"-DFMI_VERSION={version[0]}",
            "-DDISABLE_PREFIX",
            "-I",
            str(sources / "include"),
            "-I",
            str(model),
        ]
        words += ["-o", str(library), str(model / "model.c")]
        words += [str(sources / "src" / name) for name in (f"fmi{version[0]}Functions.c", "cosimulation.c")]
        subprocess.run([*words, "-lm"], check=True)
        with zipfile.ZipFile(path, "w") as archive:
            archive.write(model / f"FMI{version[0]}.xml", "modelDescription.xml")
            archive.write(library, f"binaries/{FOLDERS[version]['linux']}/Feedthrough.so")
        through = {"variable": "Float64_continuous_output"}
        units = {"position": "m", "velocity": "m/s", "spool_position": "m", "force": "N"}
        outputs = {signal: {**through, "unit": unit} for signal, unit in units.items()}
        inputs = {
            "valve_command": {"variable": "Float64_continuous_input", "unit": "m"},
            "disturbance_force": {"variable": "Float64_discrete_input", "unit": "N"},
        }
        rig = load_rig(configured("rig_paper"))
        plant = ForeignPlant(path, map_from_mapping({"inputs": inputs, "outputs": outputs}, "map"), rig, PERIOD)
        begun = time.perf_counter()
        for step in range(1000):
            plant.advance(1e-6 * step, 0.0, 0.0, 0.0, 0.0)
        took = (time.perf_counter() - begun) / 1000
        position = float(plant.truth[0])
        plant.close()
        state = "as commanded" if position == 1e-6 * 999 else f"WRONG: {position}"
        print(f"  Feedthrough, FMI {version}, as plant: {state}, {1e6 * took:.0f} us per cycle with its process")


def python_fmu(folder: Path) -> None:
    """Time the simulator exported by PythonFMU3, whose FMU needs Python."""
    builder = import_module("pythonfmu3.builder")
    script = folder / "python_rig.py"
    script.write_text(
        "from pythonfmu3 import Fmi3Causality, Fmi3Slave, Fmi3Variability, Float64\n"
        "from ehls_ros.experiments.files import configured\n"
        "from ehls_ros.experiments.spec import load_rig\n"
        "from ehls_ros.physics.simulator import Simulator\n"
        "import numpy as np\n"
        "class PythonRig(Fmi3Slave):\n"
        "    def __init__(self, **kwargs):\n"
        "        super().__init__(**kwargs)\n"
        "        self.time, self.valve_command, self.force = 0.0, 0.0, 0.0\n"
        "        self.rig, self.quiet = Simulator(load_rig(configured('rig_paper'))), np.zeros(7)\n"
        "        kinds = dict(variability=Fmi3Variability.continuous)\n"
        "        self.register_variable(Float64('time', causality=Fmi3Causality.independent, **kinds))\n"
        "        self.register_variable(Float64('valve_command', causality=Fmi3Causality.input, start=0.0, **kinds))\n"
        "        self.register_variable(Float64('force', causality=Fmi3Causality.output, **kinds))\n"
        "    def do_step(self, now, step):\n"
        "        self.rig.advance(self.valve_command, 0.0, 0.0, 0.0, 0.0)\n"
        "        self.force = float(self.rig.measure(self.quiet)[4])\n"
        "        return True\n",
        encoding="utf-8",
    )
    made = builder.FmuBuilder.build_FMU(str(script), dest=str(folder))
    took = stepping_time(Path(made))
    print(f"  the simulator through PythonFMU3: {1e6 * took:.1f} us per step, {PERIOD / took:.0f} x real time")


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__)
    parser.add_argument("--reference-fmus", type=Path, help="checkout of the Reference FMUs")
    parser.add_argument("--python-fmu", action="store_true", help="compare with PythonFMU3")
    parser.add_argument("--cells", type=int, default=8, help="cells of Table 3 (default: all)")
    options = parser.parse_args()
    folder = Path(tempfile.mkdtemp(prefix="ehls_fmu_bench_"))
    try:
        _measure(folder, options)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _measure(folder: Path, options: Any) -> None:
    rig = load_rig(configured("rig_paper"))
    model = plant_model(rig, "rig")
    paths = {}
    for version in VERSIONS:
        begun = time.perf_counter()
        content = fmu(model, version, {}, "benchmark")  # type: ignore[arg-type]
        took = time.perf_counter() - begun
        path = paths[version] = folder / f"rig_{version[0]}.fmu"
        path.write_bytes(content)
        with zipfile.ZipFile(path) as archive:
            sizes = {entry.filename: entry.file_size for entry in archive.infolist() if entry.filename.startswith("binaries")}
            needed = {
                name: sorted({m.decode() for m in re.findall(rb"[\w+-]+\.(?:dll|so\.\d)\b", archive.read(name))} - {"rig.dll"})
                for name in sizes
            }
        remarks = validate_fmu(str(path)) or "none"
        print(f"FMI {version}: exported in {took:.1f} s, {len(content) / 1024:.0f} KiB; remarks of FMPy: {remarks}")
        for name, size in sizes.items():
            print(f"  {name}: {size / 1024:.0f} KiB, needs {', '.join(needed[name])}")
        for text, periods, alone in (("1 ms", 1, False), ("1 ms, doStep alone", 1, True), ("10 ms", 10, False)):
            took = stepping_time(path, periods=periods, alone=alone)
            print(f"  steps of {text} in FMPy: {1e6 * took:.1f} us, {periods * PERIOD / took:.0f} x real time")
        begun = time.perf_counter()
        start = {"valve_command": 1e-4}
        simulate_fmu(str(path), stop_time=10.0, output_interval=PERIOD, fmi_type="CoSimulation", start_values=start)
        print(f"  simulate_fmu, 10 s recorded at 1 kHz: {10.0 / (time.perf_counter() - begun):.0f} x real time")
    if options.python_fmu:
        python_fmu(folder)
    if options.reference_fmus is not None:
        _other_importers(folder, options.reference_fmus.resolve(), paths)
    print("Table 3 with a plant FMU and a controller FMU, largest difference from our own run, relative:")
    cells = [paper.Cell(paper.FASMC_2, r, d) for r in paper.REFERENCES for d in paper.DISTURBANCES][: options.cells]
    for cell in cells:
        spec = case(cell)
        law = folder / "law.fmu"
        use, watching = spec.controller, spec.compensation
        made = law_model(spec.controller_rig, "law", PERIOD, use.name, use.parameters, watching.name, watching.parameters)
        law.write_bytes(fmu(made, "3.0", {}, "benchmark", ["linux"]))
        force, command = cell_errors(spec, paths["3.0"], law)
        print(f"  {cell.reference:<10} {cell.disturbance}: force {force:.1e}, command {command:.1e}", flush=True)


def _other_importers(folder: Path, sources: Path, paths: dict[str, Path]) -> None:
    for system in ("linux", *(["windows"] if shutil.which("wine") else [])):
        program = str(importer(sources, system, folder))
        command = [program] if system == "linux" else [str(shutil.which("wine")), program]
        for version, path in paths.items():
            found, wanted = imported(command, path, version, system, 2000, folder), last_outputs(path, 2000)
            same = "to the bit" if np.array_equal(found, wanted) else f"differs by {np.abs(found - wanted).max():.1e}"
            print(f"  reference FMUs' importer, FMI {version}, {system}: as in FMPy {same}")
    feedthrough(sources, folder)


if __name__ == "__main__":
    main()
