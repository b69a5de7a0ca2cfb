"""The configuration for diagnostic_aggregator puts every node's diagnostics into one group."""

from pathlib import Path

import yaml

from ehls_ros.nodes import node_names

FILE = Path(__file__).resolve().parents[2] / "config" / "diagnostic_aggregator.yaml"
PARAMETERS = yaml.safe_load(FILE.read_text(encoding="utf-8"))["analyzers"]["ros__parameters"]
GROUPS = {name: group for name, group in PARAMETERS.items() if name != "path"}


def groups_of(status: str) -> list[str]:
    """Return the groups that include a status of this name, like GenericAnalyzer with its name filters."""
    return [name for name, group in GROUPS.items() if any(part in status for part in group["contains"])]


def test_every_node_is_in_one_group_in_any_namespace():
    assert {group["type"] for group in GROUPS.values()} == {"diagnostic_aggregator/GenericAnalyzer"}
    for name in node_names():
        assert len(groups_of(name)) == 1, name
        # test_two_rigs.py finds the nodes of a second rig under such names.
        assert groups_of(f"rig2/{name}") == groups_of(name)


def test_the_groups_name_nodes_that_exist():
    named = [part for group in GROUPS.values() for part in group["contains"]]
    assert sorted(named) == sorted(node_names())
