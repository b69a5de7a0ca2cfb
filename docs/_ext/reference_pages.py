"""The reference pages, generated from the code's declarations into docs/reference/ at every build of the site."""

import argparse
import ast
import inspect
import os
import pkgutil
import re
import runpy
import sys
from collections.abc import Iterable, Iterator, Mapping
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, NamedTuple, get_args, get_origin
from unittest import mock

import ehls_ros
from ehls_ros import diagnosis
from ehls_ros.cli.main import parser
from ehls_ros.control.companions import COMPANIONS
from ehls_ros.control.controllers import CONTROLLERS
from ehls_ros.control.disturbances import DISTURBANCES
from ehls_ros.control.observers import OBSERVERS
from ehls_ros.control.programme import declaration as programme_declaration
from ehls_ros.control.programme.blocks import BLOCKS
from ehls_ros.control.references import REFERENCES
from ehls_ros.declared_numbers import declared_numbers
from ehls_ros.diagnosis import rules
from ehls_ros.experiments import spec
from ehls_ros.experiments.campaign import plan, variation
from ehls_ros.families import Family
from ehls_ros.hardware import calibration, gate_parameters
from ehls_ros.hardware.backends import BACKENDS
from ehls_ros.nodes import controller_of, node_names
from ehls_ros.physics import parameters as rig
from ehls_ros.physics.cylinder import CYLINDERS
from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.friction import FRICTION_MODELS
from ehls_ros.physics.valve import VALVES
from ehls_ros.recording import columns, topics
from ehls_ros.schema import Declaration, declarations
from ehls_ros.trajectory import AS_RIGS_GIVE, SIGNALS

ROOT = Path(ehls_ros.__file__).parent.parent
MESSAGES = ROOT / "ehls_msgs" / "msg"
LAUNCH = ROOT / "launch" / "ehls.launch.py"
LAUNCH_MODULES = (
    "ament_index_python", "ament_index_python.packages", "launch", "launch.actions", "launch.launch_context",
    "launch.substitutions", "launch_ros", "launch_ros.actions", "launch_ros.parameter_descriptions",
)  # fmt: skip
WIDTH = "100"


class Section(NamedTuple):
    """A parameter set with its heading and the file that declares it."""

    title: str
    about: str
    parameters: type
    file: Path


FAMILIES: Mapping[str, Family[Any]] = {
    "Rig file: friction": FRICTION_MODELS,
    "Rig file: cylinder": CYLINDERS,
    "Rig file: valve": VALVES,
    "Controllers": CONTROLLERS,
    "Companions": COMPANIONS,
    "Friction observers": OBSERVERS,
    "References": REFERENCES,
    "Programme blocks": BLOCKS,
    "Disturbances": DISTURBANCES,
    "Effects": EFFECTS,
    "DAQ backends": BACKENDS,
}

FILES: Mapping[str, tuple[tuple[str, type, ModuleType], ...]] = {
    "Experiment file": (("Settings", spec.Settings, spec),),
    "Rig file": (
        ("plant", rig.Plant, rig),
        ("sensors: each signal", rig.Sensor, rig),
        ("limits", rig.Limits, rig),
    ),
    "Campaign file": (
        ("Settings of a campaign", plan.Settings, plan),
        ("vary: a range", variation.Range, variation),
        ("vary: a distribution", variation.Distribution, variation),
    ),
    "Bridge file": (("channels", calibration.Input, calibration), ("command", calibration.Output, calibration)),
    "Programme file": (
        ("Settings of a programme", programme_declaration.Parameters, programme_declaration),
        ("limits of a programme", programme_declaration.Limits, programme_declaration),
        ("pacing of a programme", programme_declaration.Pacing, programme_declaration),
    ),
    "Column map": (
        ("A column", columns.Column, columns),
        ("cylinder", columns.Cylinder, columns),
        ("rotary", columns.Rotary, columns),
    ),
}

API: Mapping[str, tuple[str, ...]] = {
    "Recordings": ("load", "Recording"),
    "Simulation": ("simulate", "Simulation", "campaign", "CampaignResult"),
    "Diagnosis": ("diagnose", "DiagnosisResult"),
    "Monitoring": ("monitor", "MonitorResult"),
    "Identification": ("identify", "FrictionResult", "RigResult", "Estimate"),
    "Tuning": ("tune", "TuningResult"),
    "Verification": ("verify", "VerificationResult"),
    "Loops of one's own": ("controller", "SteppedController", "plant", "SteppedPlant"),
    "Rigs": ("rig", "save_rig", "Rig"),
    "More": ("evaluate", "Metrics", "Spec", "Simulator"),
    "Errors": ("BadInput", "WorkFailed"),
}
"""Public names of the package, by heading."""

PUBLIC = (
    "`import ehls_ros as ehls`. The names on this page, those of `ehls.__all__`, are stable, and so is what the how-tos import"
    " for a controller, an effect or another member of a family; everything else in the package is private and may change. A"
    " caller's mistake raises `BadInput`, whose message says what, where, and what was expected. What fails numerically is a"
    " result that says so.\n"
)
"""What may be used."""

RECORDS = (
    "ehls_ros.trajectory.Trajectory",
    "ehls_ros.diagnosis.result.Diagnosis",
    "ehls_ros.diagnosis.result.Cause",
    "ehls_ros.experiments.consequences.Consequences",
    "ehls_ros.identification.result.Identification",
    "ehls_ros.identification.rig_result.RigIdentification",
    "ehls_ros.experiments.campaign.results.CampaignResults",
    "ehls_ros.experiments.verification.results.Verification",
    "ehls_ros.experiments.verification.results.JudgedBlock",
    "ehls_ros.experiments.verification.results.Cyclic",
    "ehls_ros.experiments.verification.results.NonCyclic",
    "ehls_ros.experiments.verification.results.Quantity",
)
"""What public results are made of."""

TOPICS: Mapping[str, str] = {
    "loader_state": "one atomic snapshot of the sensors, which opens a control cycle",
    "chamber_pressures": "pressures of both chambers in a cycle, of a rig whose cylinder has two",
    "force_reference": "wanted force of a cycle, with two derivatives",
    "position_reference": "wanted position of a cycle, with two derivatives, for controllers that follow a position",
    "programme_point": "where a test programme is in a cycle: block, load cycles, phase",
    "actuator_force_reference": "force that the actuator under test is commanded in a cycle, with two derivatives; published "
    "where a companion uses it",
    "actuator_position_reference": "position that it is commanded, where it is a position servo",
    "disturbance": "action of the actuator under test in a cycle",
    "friction_estimate": "friction that the model predicts for a cycle",
    "valve_command": "the controller's answer to a cycle",
    "controller_status": "internal state of the controller in a cycle",
    "driving": "whether commands reach the valve; published on change",
    "force": "driving force of the cylinder [N], positive where it pushes the piston in its positive direction",
    "wrench": "the same force, along x of its frame [N]",
    "load_pressure": "pressure between the cylinder's ports [Pa]: a difference that may be negative, though `FluidPressure` is "
    "described as absolute",
    "supply_pressure": "supply pressure at the valve [Pa], above the tank's; not absolute either",
    "pressure_a": "pressure in the chamber that pushes towards +x [Pa], of a cylinder with two chambers; not absolute either",
    "pressure_b": "pressure in the chamber that pushes towards -x [Pa], likewise",
    "oil_temperature": "oil temperature [°C], as `Temperature` has it; `loader_state` has it in K",
    "joint_states": "joint `loader`: position [m], velocity [m/s], effort [N]; an array is empty where nothing is measured",
    "driver": "which controller the gate obeys, and from which cycle on; published on change; not recorded, as each command "
    "names its sender",
    "accepted_rig": "the rig with the changes that an operator has accepted, for controllers with `accept_rig`; not recorded",
    "standby_command": "what a controller that stands by would command; not recorded",
    "leaving": "sender of a node that ends; not recorded",
    "refused": "input, sender that a reader refuses, and the sender that owns the input; not recorded",
    "model_health": "what the monitor knows of the rig: changes, coefficients; on change and once in a while; not recorded",
    "/diagnostics": "state of each node",
    "/parameter_events": "changes of parameters",
    "/rosout": "log of all nodes",
}
"""What the topics hold; those from `force` to `joint_states` are at `telemetry_rate`, and only of what the rig measures."""

SERVICES: Mapping[str, str] = {
    "emergency_stop": "closes the valve at once and latches; returns the name of the stop",
    "acknowledge_stop": "acknowledges the named emergency stop, at the earliest one second after it; the trip remains",
    "unload": "lets the load pressure decay, then closes the valve; the way out of position control, and an end of a test",
    "reset_trips": "clears the causes of a trip; refused while one persists or an emergency stop is engaged",
    "programme_stop": "stops the test programme: along its own path to rest, then to the force held",
    "programme_resume": "goes on with a stopped programme where it was",
    "programme_skip": "leaves the running block for the next one",
    "monitor_accept": "takes the rig with its changes for the healthy one: writes `rig_accepted.yaml`, tells controllers with "
    "`accept_rig`, and measures the force error before and after",
    "monitor_acknowledge": "takes note that an operator has seen the changes that were found: no warning of them any more",
    "monitor_reset": "after a repair: what was found is over, and what the healthy rig is is learnt again",
    "enable": "lets commands through with a blend-in, or shuts them off",
    "switch_controller": "hands the valve to a controller that stands by, without a bump; refused if none has that name",
}


def setup(app: Any) -> dict[str, bool]:
    """Write the pages before Sphinx reads the sources."""
    app.connect("config-inited", lambda app, config: write(Path(app.srcdir) / "reference"))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def write(folder: Path) -> None:
    """Write all pages into a folder; unchanged pages keep their time stamp."""
    folder.mkdir(exist_ok=True)
    pages = {
        "commands": commands_page, "parameters": parameters_page, "nodes": nodes_page, "messages": messages_page,
        "signals": signals_page, "rules": rules_page, "python": python_page,
    }  # fmt: skip
    texts = {name: page() for name, page in pages.items()} | {"index": index_page(pages)}
    for name, text in texts.items():
        path = folder / f"{name}.md"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def index_page(pages: Iterable[str]) -> str:
    """Return the index page."""
    names = "\n".join(pages)
    return f"# Reference\n\nGenerated from the code when the site is built.\n\n```{{toctree}}\n:maxdepth: 2\n\n{names}\n```\n"


# --- commands ---------------------------------------------------------------------------------------------------------


def commands_page() -> str:
    """Return the help of every verb."""
    parts = ["# Commands\n\n`ehls VERB`; exit code 0: done, 1: the work failed, 2: the input was wrong, 130: interrupted.\n"]
    with mock.patch.dict(os.environ, {"COLUMNS": WIDTH, "NO_COLOR": "1"}):
        for name, verb in verbs(parser()).items():
            parts.append(f"## ehls {name}\n\n```text\n{verb.format_help()}```\n")
    return "\n".join(parts)


def verbs(top: argparse.ArgumentParser) -> Mapping[str, argparse.ArgumentParser]:
    """Return the parser of each verb."""
    actions = top._actions  # noqa: SLF001 - argparse has no public way
    return next(dict(action.choices) for action in actions if isinstance(action, argparse._SubParsersAction))  # noqa: SLF001


PARAMETERS = (
    "# Parameters\n\nThe keys of YAML files, in SI units unless noted. A default such as 5500 × force is that for the paper's"
    " rig; on another it is multiplied by the ratio of the two rigs' [quantities](../design.md#parameters).\n"
)
"""Heading of the page."""


# --- parameters -------------------------------------------------------------------------------------------------------


def parameters_page() -> str:
    """Return the tables of all keys of YAML files."""
    parts = [PARAMETERS]
    for title, sets in FILES.items():
        parts.append(f"## {title}\n")
        parts += [text_of(Section(name, "", declared, Path(module.__file__ or ""))) for name, declared, module in sets]
    for title, family in FAMILIES.items():
        parts.append(f"## {title}\n")
        parts += [text_of(section) for section in members(family)]
    return "\n".join(parts)


def members(family: Family[Any]) -> Iterator[Section]:
    """Yield a section for each member of a family."""
    for name in family.names():
        member = family.load(name)
        about = first_sentence(member)
        if hasattr(member, "EQUATION"):
            about += f"\n\n    {member.EQUATION}\n\nSource: {member.SOURCE}."
        yield Section(name, about, member.Parameters, Path(member.__file__))


def text_of(section: Section) -> str:
    """Return a section: heading, description, table, and file."""
    link = f"[{section.file.name}](../../{section.file.relative_to(ROOT)})"
    about = f"{section.about}\n\n" if section.about else ""
    return f"### {section.title}\n\n{about}{table(section.parameters)}\nDeclared in {link}.\n"


def table(parameters: type) -> str:
    """Return the table of a parameter set."""
    rows = [
        (f"`{d.name}`", shown_default(parameters, d), shown_unit(d), shown_range(d), d.description)
        for d in declarations(parameters)
    ]
    return rows_of(("name", "default", "unit", "range", "description"), rows) if rows else "No parameters.\n"


def shown_default(parameters: Any, declared: Declaration) -> str:
    """Return a default as text."""
    if declared.name not in parameters._field_defaults:
        return "required"
    default = declared.default
    if isinstance(default, float):
        return f"{default:g} × {declared.scale}" if declared.scale else f"{default:g}"
    if isinstance(default, tuple):
        return f"[{', '.join(f'{value:g}' for value in default)}]"
    if isinstance(default, bool):
        return str(default).lower()
    return "–" if default in ("", None) else str(default)


def shown_unit(declared: Declaration) -> str:
    """Return a unit as text; text parameters have none."""
    return declared.unit or "–"


def shown_range(declared: Declaration) -> str:
    """Return a range as text."""
    if declared.kind is bool:
        return "true, false"
    if get_origin(declared.kind) is Literal:
        return ", ".join(get_args(declared.kind))
    low = "" if declared.minimum is None else f"{declared.minimum:g}"
    high = "" if declared.maximum is None else f"{declared.maximum:g}"
    return f"{low} … {high}".strip() if low or high else "–"


def rows_of(heading: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a Markdown table."""
    lines = [list(heading), *(list(row) for row in rows)]
    lines.insert(1, ["---"] * len(lines[0]))
    return "".join("| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |\n" for line in lines)


def first_sentence(thing: Any) -> str:
    """Return the first paragraph of a docstring, as one line."""
    return " ".join((inspect.getdoc(thing) or "").split("\n\n")[0].split())


# --- nodes ------------------------------------------------------------------------------------------------------------


def nodes_page() -> str:
    """Return the nodes with their ROS parameters, the launch arguments, topics and services."""
    parts = [
        "# Nodes, launch file, topics, services\n",
        "`ros2 run ehls_ros NODE`, or `ehls run NODE`. Parameters of control laws and the gate can be changed at run time.\n",
        "## Launch arguments\n\n`ros2 launch ehls_ros ehls.launch.py NAME:=VALUE`\n",
        rows_of(
            ("name", "default", "description", "choices"),
            (
                (f"`{name}`", default or "–", about, ", ".join(filter(None, choices or ())) or "–")
                for name, (default, about, choices) in launch_arguments().items()
            ),
        ),
        "## Topics\n",
        rows_of(
            ("topic", "type", "what it holds"),
            (
                (f"`{topic.resolve()}`", f"`{topic.type}`", TOPICS[topic.name])
                for topic in (*topics.TOPICS, topics.MODEL_HEALTH, *topics.HANDOVER_TOPICS)
            ),
        ),
        "## Services\n\nOf the plant node (`plant_sim_node` or `hardware_bridge_node`), `programme_node`, `monitor_node`.\n",
        rows_of(("service", "type", "what it does"), services()),
        "## Parameters of every node\n",
        table(import_module("ehls_ros.nodes.control").Common),
    ]
    for name in node_names():
        law = controller_of(name)
        about = CONTROLLERS.load(law) if law else import_module(f"ehls_ros.nodes.{name}")
        parts.append(f"## {name}\n\n{first_sentence(about)}\n")
        parts += [table(own) for own in own_parameters(name)]
        parts += [f"[Parameters of the control law](parameters.md#{slug(law)}).\n"] if law else []
    parts.append(f"## The safety gate\n\nParameters of the plant node.\n\n{table(gate_parameters.Parameters)}")
    return "\n".join(parts)


def own_parameters(node: str) -> tuple[type, ...]:
    """Return the parameter sets of a node, without the common ones, the safety gate's and the control law's."""
    if controller_of(node):
        return (import_module("ehls_ros.nodes.controller").Parameters,)
    module = import_module(f"ehls_ros.nodes.{node}")
    sets: list[type] = [module.Parameters] if hasattr(module, "Parameters") else []
    if node in {"plant_sim_node", "hardware_bridge_node"}:
        sets.insert(0, import_module("ehls_ros.nodes.plant").Parameters)
    if node == "monitor_node":
        sets.insert(0, import_module("ehls_ros.experiments.monitoring.monitor").Parameters)
    return tuple(sets)


def node_parameters(node: str) -> Mapping[str, Declaration]:
    """Return all declared parameters of a node by name."""
    sets = [import_module("ehls_ros.nodes.control").Common, *own_parameters(node)]
    if law := controller_of(node):
        sets.append(CONTROLLERS.load(law).Parameters)
    if node in {"plant_sim_node", "hardware_bridge_node"}:
        sets.append(gate_parameters.Parameters)
    return {declared.name: declared for parameters in sets for declared in declarations(parameters)}


def launch_arguments() -> Mapping[str, tuple[str, str, list[str] | None]]:
    """Return default, description and choices of the launch arguments; `launch` need not be installed."""
    absent = {name: mock.MagicMock() for name in LAUNCH_MODULES}
    with mock.patch.dict(sys.modules, absent):
        found: Mapping[str, tuple[str, str, list[str] | None]] = runpy.run_path(str(LAUNCH))["ARGUMENTS"]
    return found


def services() -> Iterator[tuple[str, str, str]]:
    """Yield name, type and description of every service, from the calls that create them."""
    yield from plant_services()
    names = (
        *(f"programme_{request}" for request in ("stop", "resume", "skip")),
        "monitor_accept",
        "monitor_acknowledge",
        "monitor_reset",
    )
    for name in names:
        yield f"`{topics.NAMESPACE}/{name}`", "`std_srvs/srv/Trigger`", SERVICES[name]


def plant_services() -> Iterator[tuple[str, str, str]]:
    """Yield those of the plant node."""
    for file in ("gate_services.py", "plant.py"):
        tree = ast.parse((ROOT / "ehls_ros" / "nodes" / file).read_text(encoding="utf-8"))
        imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and str(node.module).endswith(".srv")]
        package_of = {name.name: str(node.module).removesuffix(".srv") for node in imports for name in node.names}
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "create_service":
                kind, name = ast.unparse(node.args[0]), str(ast.literal_eval(node.args[1]))
                yield f"`{topics.NAMESPACE}/{name}`", f"`{package_of[kind]}/srv/{kind}`", SERVICES[name]


# --- messages, signals, rules, Python ---------------------------------------------------------------------------------


def messages_page() -> str:
    """Return the fields of every message."""
    parts = ["# Messages\n\nMessages of the package `ehls_msgs`.\n"]
    for path in sorted(MESSAGES.glob("*.msg")):
        lines = path.read_text(encoding="utf-8").splitlines()
        about = " ".join(line.removeprefix("#").strip() for line in lines if line.startswith("#"))
        fields = [found for line in lines if (found := re.match(r"(\S+)\s+(\w+(?:=\w+)?)\s*(?:#\s*(.*))?$", line))]
        rows = ((f"`{name}`", f"`{kind}`", comment or "–") for kind, name, comment in (field.groups() for field in fields))
        parts.append(f"## {path.stem}\n\n{about}\n\n{rows_of(('field', 'type', 'description'), rows)}")
    return "\n".join(parts)


def signals_page() -> str:
    """Return the names of the data contract."""
    heading = ("name", "description", "unit")
    tables = [[(f"`{name}`", s.label, s.unit) for name, s in group.items()] for group in (SIGNALS, AS_RIGS_GIVE)]
    return (
        "# Signals\n\nColumns of CSV, MAT and Parquet files, and names in a `Trajectory`. `time_s` comes first.\n\n"
        + rows_of(heading, tables[0])
        + "\n## As other rigs give them\n\nTurned into the signals above on reading.\n\n"
        + rows_of(heading, tables[1])
    )


def rules_page() -> str:
    """Return the tuning numbers of diagnosis: those of judgement, then those of its algorithms, module by module."""
    parts = [
        "# Rules of diagnosis\n\nEvery tuning number of `ehls diagnose`.\n",
        "A *whitened* residual is in units of its noise floor; 1 nat is a factor e of likelihood.\n",
    ]
    names = (module.name for module in pkgutil.walk_packages(diagnosis.__path__, f"{diagnosis.__name__}."))
    for module in (rules, *(import_module(name) for name in names if name != rules.__name__)):
        rows = [
            (f"`{n.name}`", f"{n.value:g}", n.meaning, f"`{n.derived}`" if n.derived else n.origin or "chosen")
            for n in declared_numbers(module)
        ]
        if rows:
            title = "Judgement" if module is rules else f"`{module.__name__.removeprefix(f'{diagnosis.__name__}.')}.py`"
            parts.append(f"## {title}\n\n{rows_of(('name', 'value', 'what it is', 'where it comes from'), rows)}")
    return "\n".join(parts)


def python_page() -> str:
    """Return the autodoc directives of the Python interface."""
    parts = [
        "# Python\n",
        PUBLIC,
    ]
    for title, names in API.items():
        parts.append(f"## {title}\n")
        parts += [documented(f"ehls_ros.{name}") for name in names]
    parts.append("## Fields of results\n\nResults have the fields of these records, which are no names of the package.\n")
    parts += [documented(name) for name in RECORDS]
    return "\n".join(parts)


def documented(name: str) -> str:
    """Return the autodoc directive of a function or class; the docstring of a class has its fields."""
    module, _, member = name.rpartition(".")
    found = getattr(import_module(module), member)
    if not inspect.isclass(found):
        return f"```{{eval-rst}}\n.. autofunction:: {name}\n```\n"
    fields = ", ".join(getattr(found, "_fields", ()))
    options = f"   :members:\n{f'   :exclude-members: {fields}' if fields else ''}\n"
    return f"```{{eval-rst}}\n.. autoclass:: {name}\n{options}```\n"


def slug(title: str) -> str:
    """Return the anchor of a heading."""
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
