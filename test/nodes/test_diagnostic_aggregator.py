"""The configuration for diagnostic_aggregator puts every node's diagnostics into one group."""

from pathlib import Path

import yaml

from ehls_ros.nodes import node_names

ROOT = Path(__file__).resolve().parents[2]
GROUPS = yaml.safe_load((ROOT / "config" / "diagnostic_aggregator.yaml").read_text(encoding="utf-8"))["analyzers"][
    "ros__parameters"
]


def groups_of(status: str) -> list[str]:
    """Return the groups that take a status of this name, as GenericAnalyzer does with what names contain."""
    groups = {name: group for name, group in GROUPS.items() if name != "path"}
    assert {group["type"] for group in groups.values()} == {"diagnostic_aggregator/GenericAnalyzer"}
    return [name for name, group in groups.items() if any(part in status for part in group["contains"])]


def test_every_node_is_in_one_group_in_any_namespace():
    for name in node_names():
        assert len(groups_of(name)) == 1, name
        # As test_two_rigs.py finds the names of a second rig.
        assert groups_of(f"rig2/{name}") == groups_of(name)


def test_the_groups_name_nodes_that_exist():
    named = [part for name, group in GROUPS.items() if name != "path" for part in group["contains"]]
    assert sorted(named) == sorted(set(named) & set(node_names()))
