"""Results as JSON: lossless, and with stable keys in the public schemas."""

import json
import math
from dataclasses import dataclass
from typing import NamedTuple, get_type_hints

from ehls_ros.diagnosis.reading import Power, Reading
from ehls_ros.diagnosis.result import (
    BaselineSummary,
    ChannelGain,
    Coverage,
    Fitted,
    Gain,
    Healthy,
    Sensitivity,
    StageResult,
    Term,
)
from ehls_ros.estimate import Estimate
from ehls_ros.experiments import diagnosis_document as document
from ehls_ros.experiments.controller_benefit import BenefitCase, ControllerBenefit, Steady
from ehls_ros.experiments.json_document import json_document
from ehls_ros.experiments.next_experiment import NextExperiment, Pair
from ehls_ros.reproduction.results import CellResult

SCHEMA = {
    document.DiagnosisDocument: (
        "verdict summary stages causes remainder depends_on gain next_experiment extended_rig seed version unknown_stage"
        " partial missing not_judged sensitivities controller_gain free_run remarks diagnosis_s wall_s baseline corrected term"
        " checks"
    ),
    Term: (
        "effect argument magnitude unit at values std period closed direction reading"
        " formula factor factor_reach error factor_error lag play"
    ),
    Reading: "amplitude std rise power place",
    Power: "exponent std symmetry",
    StageResult: ("judged why_not nrmse_before nrmse_after noise_floor exceeds unexplained leaves_much incident depends_on"),
    document.BaselineEntry: "recordings coefficients channels coverage not_compared",
    Fitted: "given fitted spread",
    Healthy: "stage fitted left noise_floor allowed together",
    Coverage: "signal baseline new beyond",
    document.ParameterEntry: "value std unit ci95",
    document.RemainderEntry: "nrmse noise_floor depends_on",
    document.CauseEntry: "name probability share channel equivalent_to stage group parameters fixed evidence advice side",
    document.Advice: "inspect measure change",
    document.Evidence: "gain_nats standard_errors_from_neutral equation rivals",
    document.RivalEntry: "name behind_nats closed_fraction parameters",
    document.UnknownEntry: "name probability equivalent_to stage parameters evidence",
    document.UnknownEvidence: "depends_on partial nrmse noise_floor",
    document.GainEntry: "channel heldout_nrmse_before heldout_nrmse_after noise_floor closed_fraction ci95 channels",
    ChannelGain: "closed noise",
    document.FreeRunEntry: "seconds nrmse remarks",
    document.BeforeAfter: "before after",
    Estimate: "value std unit",
    Sensitivity: "name parameter smallest unit",
    NextExperiment: "name purpose why separation spec",
    Pair: "one other sigma",
    ControllerBenefit: "cases same_controller reason",
    BenefitCase: "case force_n before after",
    Steady: "max_error_n rms_error_n trouble",
    CellResult: (
        "controller reference disturbance max_error_n rms_error_n relative_percent paper_percent convergence_s"
        " convergence_band_n oscillation_n paper_convergence_s causal_limit_n"
    ),
}
"""Keys of ``diagnosis.json`` and of a cell of ``table3.json``: scripts read them, so they change only on purpose."""


def test_public_documents_keep_their_keys():
    assert {record.__name__: list(get_type_hints(record)) for record in SCHEMA} == {
        record.__name__: keys.split() for record, keys in SCHEMA.items()
    }


def test_a_gain_becomes_its_entry_field_by_field():
    assert document.GainEntry._fields == Gain._fields


def test_a_baseline_becomes_its_entry_field_by_field():
    assert document.BaselineEntry._fields == BaselineSummary._fields[: len(document.BaselineEntry._fields)]


class Inner(NamedTuple):
    numbers: tuple[float, ...]


@dataclass(frozen=True)
class Outer:
    by_name: dict[str, Inner]
    flag: bool


def test_records_become_objects_of_their_fields_at_any_depth():
    nested = [Outer({"a": Inner((1.0, math.inf, -math.inf, math.nan))}, flag=True), "text", None, 2]
    written = json_document(nested)
    assert written == [{"by_name": {"a": {"numbers": [1.0, None, None, None]}}, "flag": True}, "text", None, 2]
    assert json.loads(json.dumps(written, allow_nan=False)) == written
