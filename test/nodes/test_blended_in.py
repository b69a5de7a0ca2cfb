"""While the gate blends the commands in, adaptation does not take the valve's smaller opening for its gain."""

import pytest

pytest.importorskip("ehls_msgs.msg._driver", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray

CYCLES = 1500


@pytest.mark.long
def test_nothing_is_adapted_while_the_commands_are_blended_in(graph, participant, spec_file):
    path = spec_file(controller="fasmc_predictive", duration=1000.0)
    path.write_text(path.read_text(encoding="utf-8") + "companions: [adaptation]\n", encoding="utf-8")
    diagnostics = participant.collect(DiagnosticArray, "/diagnostics")

    def figures():
        found = [status for array in diagnostics for status in array.status if status.name == "fasmc_predictive_node"]
        return {item.key: item.value for item in found[-1].values} if found else {}

    options = {"spec": path, "timing": "lockstep"}
    graph.start("plant_sim_node", enable_time=10.0, cycles=CYCLES, **options)
    for node in ("reference_node", "disturbance_node", "friction_estimator_node", "fasmc_predictive_node"):
        graph.start(node, **options)
    participant.until(lambda: int(figures().get("cycle", -1)) >= CYCLES - 1)
    # The file is right, so that without the blending no estimate would leave it.
    assert figures()["adaptation.valve_gain"] == figures()["adaptation.valve_bandwidth"] == "1"
    assert "not identified" in figures()["adaptation.valve_gain_told"]
