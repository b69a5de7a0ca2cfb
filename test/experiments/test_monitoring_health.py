"""The monitor's messages, and the stability of its level."""

import math
import time
from datetime import datetime
from pathlib import Path

import pytest

from ehls_ros.estimate import Estimate
from ehls_ros.experiments.monitoring.examination import FoundCause
from ehls_ros.experiments.monitoring.health import (
    GOOD,
    MIN_LEVEL_TIME,
    WARNING,
    DebouncedSummary,
    FoundChange,
    Health,
    State,
    Summary,
    format_instant,
)
from ehls_ros.experiments.spec import load_rig

RIG = load_rig(Path(__file__).resolve().parents[2] / "config" / "rig_paper.yaml")
MONDAY = round(datetime(2026, 11, 23, 9, 12).astimezone().timestamp()) * 10**9
LEAKAGE = RIG.plant.leakage_coefficient


def change(name: str, stage: str, alike: tuple[str, ...] = (), **parameters: Estimate) -> FoundChange:
    return FoundChange(1, (FoundCause(name, stage, 0.98, alike, parameters),), stage, (), 0.0, -math.inf, 1.0, 2.0, 3.0)


LEAK = change("internal_leakage_shift", "flow", added=Estimate(1.3 * LEAKAGE, 0.1 * LEAKAGE, "m^3/(s*Pa)"))
BIAS = change("pressure_sensor_bias", "sensors", ("constant_load",), bias=Estimate(2e5, 1e4, "Pa"))
UNKNOWN = FoundChange(2, (), "force_balance", ("velocity",), 0.0, 0.0, 1.0, 2.0, 3.0)


def said(*changes: FoundChange, state: State = State.WATCHING) -> Summary:
    health = Health(60.0, state, "", changes, (), 7200.0, "the rig file", 0.0, {})
    return health.summary(RIG, lambda instant: MONDAY + round(instant * 1e9))


def test_a_change_is_said_with_size_since_when_and_whose_fault():
    assert said(LEAK) == Summary(WARNING, "rig: internal leakage 2.3 × ± 0.2 since Mon 09:12, 98 %")
    assert said(BIAS).sentence == (
        "sensor: offset of the pressure sensor 2e+05 ± 2e+04 Pa since Mon 09:12, 98 % (or constant_load)"
    )
    assert said(UNKNOWN).sentence == "unknown change of the force balance since Mon 09:12, depends on velocity"
    assert (LEAK.group, BIAS.group, UNKNOWN.group) == ("flow", "sensors", "")


def test_it_warns_until_an_operator_has_seen_it():
    assert said().level == said(LEAK._replace(acknowledged=True)).level == said(LEAK._replace(cleared=9.0)).level == GOOD
    assert said().sentence == "no change against the rig file in 2 h"
    assert said(LEAK._replace(acknowledged=True)).sentence.startswith("acknowledged: rig: internal leakage")
    assert "nothing is judged" in said(state=State.IDLE).sentence


def test_a_level_holds_unless_it_worsens():
    now = [0.0]
    held = DebouncedSummary(lambda: now[0])
    good, bad = Summary(GOOD, "well"), Summary(WARNING, "worn")
    told = []
    for second in range(4 * round(MIN_LEVEL_TIME)):
        now[0] = float(second)
        told.append(held.update(bad if second % 7 == 3 else good).level)
    assert told[:4] == [GOOD, GOOD, GOOD, WARNING]
    switches = [i for i in range(1, len(told)) if told[i] != told[i - 1]]
    assert len(switches) <= 2 * len(told) / MIN_LEVEL_TIME
    assert all(
        told[i] == WARNING
        for begin in switches
        if told[begin]
        for i in range(begin, min(begin + round(MIN_LEVEL_TIME), len(told)))
    )


def test_moments_are_said_as_an_operator_would(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    stamp_ns = 1_700_000_000 * 10**9
    assert format_instant(stamp_ns, stamp_ns) == "Tue 22:13"
    assert format_instant(stamp_ns, stamp_ns + 30 * 86400 * 10**9) == "2023-11-14 22:13"
    assert format_instant(12_500_000_000, 20_000_000_000) == "12.5 s"
    assert format_instant(0, stamp_ns) == "before monitoring"
    monkeypatch.undo()
    time.tzset()
