"""A tuning's numbers in a running graph: for which they are applied, and to which node."""

import time
from pathlib import Path

import pytest

pytest.importorskip("ehls_msgs.msg._loader_state", reason="needs ehls_msgs built, as `make setup` does")

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from patience import PATIENCE

from ehls_ros.dashboard.graph import TunedNumber, Tuning, TuningPoint, TuningResult
from ehls_ros.dashboard.tuning_job import Applicable, TuningJob
from ehls_ros.dashboard.tuning_process import task_for
from ehls_ros.errors import BadInput
from ehls_ros.experiments.files import configured
from ehls_ros.experiments.spec import load_spec
from ehls_ros.nodes import dashboard_link
from ehls_ros.nodes.dashboard_graph import DashboardGraph

FOLDER = "runs/tuned"


class Ended(TuningJob):
    """A tuning that has ended."""

    def __init__(self, spec, **numbers):
        super().__init__(lambda folder, law: ["false"])
        point = TuningPoint(20.0, 6.5, 30.0, 0.03)
        values = tuple(TunedNumber(name, "1", "", 0.0, value) for name, value in numbers.items())
        result = TuningResult("", True, False, values, point, point, (), 6.0, None, ())
        self.found = Applicable("fasmc", result, task_for(spec, "fasmc", "test").spec)
        self.begun, self.noted = [], []

    def state(self):
        return Tuning("fasmc", "test", running=False, result=self.found.result, folder=FOLDER)

    def applicable(self, folder):
        if folder != FOLDER:
            raise BadInput("no longer that of the last tuning", "Apply", "the latest result")
        return self.found

    def note_application(self, applied, sentence):
        self.noted.append(sentence)

    def begin(self, spec, name, law):
        self.begun.append((spec, name, law))
        return super().begin(spec, name, law)


@pytest.fixture
def dashboard(graph, spec_file, monkeypatch, tmp_path, request):
    """Return the dashboard of a graph of plant and controller, and its experiment; the parameter is a rig for its nodes."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(dashboard_link, "DISCOVERY_TIMEOUT", PATIENCE)
    file = spec_file(duration=1.0)
    rig = getattr(request, "param", None)
    for node in ("plant_sim_node", "fasmc_node"):
        graph.start(node, spec=file, autostart="false", **({} if rig is None else {"rig": rig}))
    joined = DashboardGraph("ehls")
    deadline = time.monotonic() + PATIENCE
    while set(joined.tunable_nodes()) != {"fasmc_node", "plant_sim_node"}:
        assert time.monotonic() < deadline, joined.tunable_nodes()
        time.sleep(0.05)
    yield joined, load_spec(file, rig)
    joined.close()


def test_numbers_are_applied_together_to_the_graph_they_were_found_for(dashboard, participant):
    joined, spec = dashboard

    def value(name):
        return participant.get_parameter("fasmc_node", name).double_value

    assert (joined.laws(), joined.on_rig()) == (("fasmc",), False)
    joined._tuning = Ended(spec, g=123.0, k=1e9)
    refused = joined.apply_tuning(FOLDER, confirmed=True)
    assert not refused.done
    assert "1000" in refused.message
    assert (value("g"), value("k")) == (60.0, 12.0)
    joined._tuning = Ended(spec._replace(controller_rig=spec.controller_rig.with_plant(moving_mass=90.0)), g=123.0)
    assert "another rig or experiment" in joined.apply_tuning(FOLDER, confirmed=True).message
    joined._tuning = ended = Ended(spec, g=123.0, k=14.0)
    assert "last tuning" in joined.apply_tuning("runs/other", confirmed=True).message
    assert value("g") == 60.0
    assert participant.set_parameter("fasmc_node", "h", 30.0).successful
    applied = joined.apply_tuning(FOLDER, confirmed=False)
    assert applied.done, applied.message
    assert applied.message == "fasmc_node: g is now 123.0, k is now 14.0. Not as in the simulation: h is 30.0, was 25.0."
    assert (value("g"), value("k")) == (123.0, 14.0)
    [noted] = ended.noted
    assert noted.endswith(applied.message)
    # The graph's experiment and driving law.
    joined.tune(None, "")
    assert ended.begun == [(spec, "spec", "fasmc")]
    joined._tuning.close()
    assert list(Path("runs").glob("*")) == []


@pytest.mark.long
@pytest.mark.parametrize("dashboard", [configured("rig_paper_measured")], indirect=True, ids=["a rig in place of the spec's"])
def test_a_graph_with_a_bridge_gets_no_numbers_unless_the_operator_has_confirmed(dashboard, participant):
    joined, spec = dashboard
    joined._tuning = ended = Ended(spec, g=123.0)
    publisher = participant.node.create_publisher(DiagnosticArray, "/diagnostics", 10)
    bridge = DiagnosticArray(status=[DiagnosticStatus(name="hardware_bridge_node", message="active", hardware_id="ehls")])

    def on_rig():
        publisher.publish(bridge)
        return joined.on_rig()

    participant.until(on_rig)
    refused = joined.apply_tuning(FOLDER, confirmed=False)
    assert (refused.done, ended.noted) == (False, [])
    assert "real rig" in refused.message
    assert participant.get_parameter("fasmc_node", "g").double_value == spec.controller.parameters.g
    participant.until(on_rig)
    assert joined.apply_tuning(FOLDER, confirmed=True).done
    assert participant.get_parameter("fasmc_node", "g").double_value == 123.0
