"""`ehls new-rig`: make a rig file from data sheet values, entered on the terminal or read from a file."""

import json
from argparse import ArgumentParser, Namespace
from collections.abc import Mapping
from pathlib import Path
from typing import Any, get_args

from rich.console import Console
from rich.markup import escape

from ehls_ros.cli.arguments import add_json
from ehls_ros.cli.results import print_files, print_table
from ehls_ros.errors import BadInput
from ehls_ros.experiments.yaml_files import commented, rig_text
from ehls_ros.physics.data_sheet import HINTS, DataSheet, Source, answer, rig_values, sheet_from_mapping
from ehls_ros.physics.integration_step import SHORTEST_STEP, check_step
from ehls_ros.physics.plausibility import check_rig
from ehls_ros.physics.rig import DEFAULT_FRICTION, rig_from_mapping
from ehls_ros.recording.yaml_text import read_yaml
from ehls_ros.schema import Misfit, Note, declarations, notes

HELP = "Make a rig file from data sheets: asks for bore, stroke, rated flow and others, or reads the answers from a file."

DIGITS = 6
"""Digits of a computed value."""

TERMINAL = "the terminal"


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--out", type=Path, default=Path("my_rig.yaml"), help="rig file to write (%(default)s)")
    parser.add_argument("--from", dest="answers", type=Path, metavar="ANSWERS", help="YAML file with the answers")
    parser.add_argument("--template", action="store_true", help="print a file of answers to fill in, and write nothing")
    parser.add_argument("--overwrite", action="store_true", help="replace a file that is there already")
    add_json(parser, "each value with its origin")


def run(options: Namespace) -> int:
    """Run it."""
    if options.template:
        print(template(), end="")
        return 0
    if options.out.exists() and not options.overwrite:
        raise BadInput("the file is there already", str(options.out), "another name, or --overwrite")
    console = Console(stderr=True)
    given = _asked(console) if options.answers is None else read_yaml(options.answers, "file of answers")
    where = TERMINAL if options.answers is None else str(options.answers)
    values = rig_values(sheet_from_mapping(given, where))
    content = _content(values)
    rig = rig_from_mapping(content, where)
    check_rig(rig, where)
    check_step(rig, SHORTEST_STEP, where)
    source = "answers on the terminal" if options.answers is None else options.answers.name
    origins = {section: {key: f"{s.origin}: {s.basis}" for key, s in own.items()} for section, own in values.items()}
    _write(options.out, f"# Made by `ehls new-rig` from {source}.\n{rig_text(content, origins)}")
    _print(values, options.out)
    if options.json:
        print(json.dumps({"rig": str(options.out), "values": _document(values)}))
    return 0


def template() -> str:
    """Return an answer file with the questions only."""
    remarks = {name: _question(note, options) for name, note, options, _ in _questions()}
    lines = commented(dict.fromkeys(DataSheet._fields), remarks).replace(": null ", ":      ").splitlines()
    needed = [line for line, name in zip(lines, DataSheet._fields, strict=True) if name not in DataSheet._field_defaults]
    others = [f"# {line}" for line in lines if line not in needed]
    heading = "# Answers for `ehls new-rig --from`; a figure may have another unit, such as 3000 psi."
    return "\n".join([heading, *needed, "# The rest may be left out: a usual value is assumed then.", *others]) + "\n"


def _questions() -> list[tuple[str, Note, tuple[str, ...], Any]]:
    """Return name, declaration, choices and default of each question."""
    described = notes(DataSheet)
    kinds = {declared.name: declared.kind for declared in declarations(DataSheet)}
    choices = {name: tuple(c for c in get_args(kind) if isinstance(c, str)) for name, kind in kinds.items()}
    return [(name, described[name], choices[name], DataSheet._field_defaults.get(name, ...)) for name in HINTS]


def _question(note: Note, choices: tuple[str, ...]) -> str:
    span = "" if note.minimum is None else f", {note.minimum:g} to {note.maximum:g}"
    unit = f"{note.unit}{span}; " if note.unit else f"{' or '.join(choices)}; " if choices else ""
    return f"{unit}{note.description}"


def _asked(console: Console) -> dict[str, Any]:
    """Ask each question until its answer is valid."""
    text = "Figures of the data sheets; another unit may follow the number. Enter alone takes the value in brackets."
    console.print(text, soft_wrap=True)
    given = dict[str, Any]()
    for name, note, choices, default in _questions():
        console.print(f"[bold]{name}[/bold]: {escape(_question(note, choices))}", highlight=False)
        while name not in given:
            written = _line(console, name, _offered(note, default))
            try:
                if written:
                    given[name] = answer(name, written)
                elif default is ...:
                    console.print("  a value is required", style="red")
                else:
                    given[name] = default
            except Misfit as misfit:
                console.print(
                    f"  {escape(repr(misfit.value))} is not valid: {escape(misfit.expected)}", style="red", highlight=False
                )
    return given


def _offered(note: Note, default: Any) -> str:
    """Return the value that Enter alone selects."""
    if default is ...:
        return ""
    usual = f"{note.typical:g} {note.unit}, assumed" if note.typical is not None else "unknown"
    return f" [{default or usual}]"


def _line(console: Console, name: str, offered: str) -> str:
    try:
        return console.input(f"  {escape(offered)}> ").strip()
    except EOFError:
        raise BadInput(f"the answers end before {name}", TERMINAL, "an answer to each question, or --from a file") from None


def _rounded(value: Any) -> Any:
    return [_rounded(one) for one in value] if isinstance(value, list) else float(f"{value:.{DIGITS}g}")


def _content(values: Mapping[str, Mapping[str, Source]]) -> dict[str, Any]:
    """Return the content of the rig file."""
    plain = {section: {key: _rounded(source.value) for key, source in own.items()} for section, own in values.items()}
    return {
        "plant": plain["plant"],
        "friction": {"model": DEFAULT_FRICTION, **plain["friction"]},
        **{
            section: {"model": model, **plain[section]}
            for section, model in (("cylinder", "two_chamber"), ("valve", "four_edges"))
            if section in plain
        },
        "effects": _effects(plain["effects"]),
        "sensors": {name: {"noise_std": noise} for name, noise in plain["sensors"].items()},
        "limits": plain["limits"],
    }


def _effects(values: Mapping[str, float]) -> list[dict[str, Any]]:
    """Return the effects of values by effect and parameter."""
    effects = dict[str, dict[str, Any]]()
    for path, value in values.items():
        name, parameter = path.split(".")
        effects.setdefault(name, {"name": name})[parameter] = value
    return list(effects.values())


def _document(values: Mapping[str, Mapping[str, Source]]) -> dict[str, Any]:
    return {
        f"{section}.{key}": {"value": _rounded(source.value), "origin": source.origin, "from": source.basis}
        for section, own in values.items()
        for key, source in own.items()
    }


def _write(path: Path, text: str) -> None:
    """Write a file atomically."""
    scratch = path.with_name(f".{path.name}.new")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        scratch.write_text(text, encoding="utf-8")
        scratch.replace(path)
    except OSError as error:
        raise BadInput(f"the file cannot be written ({error.strerror})", str(path), "a file in a writable folder") from None
    finally:
        scratch.unlink(missing_ok=True)


def _print(values: Mapping[str, Mapping[str, Source]], path: Path) -> None:
    rows = [
        (f"{section}.{key}", f"{(s.value[0] if isinstance(s.value, list) else s.value):.4g}", escape(s.basis))
        for section, own in values.items()
        for key, s in own.items()
        if s.origin == "assumed"
    ]
    print_table("Assumed values, which no data sheet gives", ("key", "value", "how it is assumed, and what replaces it"), rows)
    print_files([("rig", path)])
