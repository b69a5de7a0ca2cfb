"""`ehls schema`: print the JSON Schema of a kind of YAML file, for editors."""

from argparse import ArgumentParser, Namespace

from ehls_ros.experiments.yaml_schemas import KINDS, schema_text

HELP = "Print the JSON Schema of a kind of YAML file, with which editors complete and check it."


def arguments(parser: ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "kind",
        choices=tuple(KINDS),
        help="the kind of file; answers: those of ehls new-rig --from; plant_map: that of --plant-map",
    )


def run(options: Namespace) -> int:
    """Run it."""
    print(schema_text(options.kind), end="")
    return 0
