"""`ehls effect`: write an effect file from a term that a diagnosis found in the data."""

import json
from argparse import ArgumentParser, Namespace
from pathlib import Path

from ehls_ros.cli.arguments import add_json
from ehls_ros.cli.results import DIAGNOSIS, print_files
from ehls_ros.errors import BadInput
from ehls_ros.experiments.effect_file import effect_text, formula_of, term_of
from ehls_ros.experiments.effect_package import add_effect, check_name

HELP = "Write a term found by `ehls diagnose` as an effect of your own package, a hypothesis of later diagnoses."

EXPECTED = "a diagnosis.json of `ehls diagnose`"


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("action", choices=("new",), help="new: write an effect")
    parser.add_argument("name", metavar="NAME", help="name of the effect, such as magnet_cogging")
    about = "diagnosis.json with the term, or the folder of the diagnosis"
    parser.add_argument("--from", dest="diagnosis", type=Path, required=True, metavar="DIAGNOSIS", help=about)
    about = "folder of your package; without a pyproject.toml, one is made (%(default)s)"
    parser.add_argument("--package", type=Path, default=Path("my_effects"), metavar="FOLDER", help=about)
    parser.add_argument("--overwrite", action="store_true", help="replace an effect of that name in the package")
    add_json(parser, "name, file, and the values found")


def run(options: Namespace) -> int:
    """Run it."""
    check_name(options.name)
    path = options.diagnosis / DIAGNOSIS if options.diagnosis.is_dir() else options.diagnosis
    term = term_of(_read(path), str(path))
    text = effect_text(options.name, term, f"term found by `ehls diagnose` in {path.resolve().parent.name}")
    added = add_effect(options.package, options.name, text, overwrite=options.overwrite)
    found = {"name": options.name, **{number.name: number.found for number in formula_of(term).numbers}}
    print_files([("effect", added.effect), ("package", added.project)])
    print(f"install it once more after each new effect: python3 -m pip install --no-deps -e {options.package}")
    print(f"as an entry of `effects` in a rig file, in place of {term.effect}: {json.dumps(found)}")
    if options.json:
        print(json.dumps({"effect": str(added.effect), "package": str(added.project), "found": found}))
    return 0


def _read(path: Path) -> object:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadInput(f"the file cannot be read ({error.strerror})", str(path), EXPECTED) from None
    except ValueError as error:
        raise BadInput(f"no JSON ({error})", str(path), EXPECTED) from None
