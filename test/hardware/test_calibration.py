"""Calibration and the bridge file: signals from raw values, raw commands, and wrong files."""

import copy
import math
from pathlib import Path

import pytest
import yaml
from third_party import install

from ehls_ros.errors import BadInput
from ehls_ros.families import offered
from ehls_ros.hardware.backends import BACKENDS
from ehls_ros.hardware.bridge_file import bridge_from_mapping
from ehls_ros.hardware.calibration import Calibration, Input, Output
from ehls_ros.physics.rig import EVERY_SENSED, SENSED

CONFIG = Path(__file__).resolve().parents[2] / "config"
POSITION = Input(channel=3, scale=0.03, offset=0.5)
PRESSURE = Input(channel=0, scale=8e5, bits=12)


@pytest.fixture
def calibration():
    return Calibration({"load_pressure": PRESSURE, "position": POSITION}, Output(channel=1, scale=-2e-3, offset=0.25))


def test_signals_in_the_order_of_a_loader_state(calibration):
    assert calibration.wired == ("position", "load_pressure")
    assert [channel.number for channel in calibration.wiring.inputs] == [3, 0]
    signals = dict(zip(SENSED, calibration.signals((2.5, -1.0)), strict=True))
    assert signals["position"] == pytest.approx(0.06)
    assert signals["load_pressure"] == pytest.approx(-8e5)
    assert all(math.isnan(signals[name]) for name in SENSED if name not in calibration.wired)


def test_chambers_with_a_channel_follow_the_other_signals():
    calibration = Calibration({"pressure_b": PRESSURE, "position": POSITION}, Output(channel=1, scale=-2e-3))
    assert calibration.wired == ("position", "pressure_b")
    signals = dict(zip(EVERY_SENSED, calibration.signals((2.5, 2.0)), strict=True))
    assert signals["pressure_b"] == pytest.approx(1.6e6)
    assert math.isnan(signals["pressure_a"])


@pytest.mark.parametrize(
    ("raw", "names"),
    [
        ((0.0, 0.0), ()),
        ((-9.999, 9.98), ()),
        ((-10.0, 0.0), ("position",)),
        ((10.0 - 20.0 / 2**16, 0.0), ("position",)),  # largest code of 16 bits
        ((0.0, 10.0 - 20.0 / 2**12), ("load_pressure",)),  # and of 12
        ((10.0, -11.0), ("position", "load_pressure")),
        ((math.nan, 0.0), ("position",)),
    ],
)
def test_value_at_the_rails_is_flagged(calibration, raw, names):
    assert calibration.saturated(raw) == names


@pytest.mark.parametrize(
    ("spool", "raw"),
    [(0.0, 0.25), (1e-3, -0.25), (-1e-3, 0.75), (0.1, -5.0), (-0.1, 5.0), (1e300, -5.0)]
    + [(wrong, 0.25) for wrong in (math.nan, math.inf, -math.inf)],
)
def test_command_stays_within_the_range(calibration, spool, raw):
    assert calibration.command(spool) == pytest.approx(raw, abs=1e-12)
    assert calibration.wiring.null == 0.25


@pytest.fixture
def content():
    return copy.deepcopy(yaml.safe_load((CONFIG / "bridge_udp.yaml").read_text()))


@pytest.mark.parametrize("file", sorted(CONFIG.glob("bridge_*.yaml")), ids=lambda path: path.name)
def test_configured_bridges_are_valid(file):
    bridge = bridge_from_mapping(yaml.safe_load(file.read_text()), file.name)
    assert file.stem == f"bridge_{bridge.backend}"
    assert bridge.calibration.wiring.output.range == (-5.0, 5.0)
    assert "velocity" not in bridge.calibration.wired
    # The rig's limits are within the range of the converters and the valve.
    assert bridge.calibration.command(1e-2) == 5.0
    at_limits = {"position": 0.29, "load_pressure": 7e6, "spool_position": 9.9e-3, "force": 1.82e4}
    for signal, channel in zip(bridge.calibration.wired, bridge.calibration.inputs, strict=True):
        assert abs(at_limits.get(signal, 0.0) / channel.scale) < 10.0


WRONG = {
    "no mapping": (lambda m: ["x"], ("list", "mapping")),
    "missing section": (lambda m: m.pop("command") and m, ("command", "missing")),
    "unknown section": (lambda m: m | {"chanels": {}}, ("chanels", "channels")),
    "no backend name": (lambda m: m["backend"].pop("name") and m, ("name", "udp")),
    "unknown backend": (lambda m: m["backend"].update(name="magic") or m, ("magic", "comedi, nidaqmx, udp")),
    "unknown key of the backend": (lambda m: m["backend"].update(prot=1) or m, ("prot", "port")),
    "port out of range": (lambda m: m["backend"].update(port=70_000) or m, ("port", "65535")),
    "unknown signal": (lambda m: m["channels"].update(positon={}) or m, ("positon", "position")),
    "channel without scale": (lambda m: m["channels"]["force"].pop("scale") and m, ("force", "scale", "missing")),
    "scale 0": (lambda m: m["channels"]["force"].update(scale=0) or m, ("force", "scale")),
    "scale nan": (lambda m: m["channels"]["force"].update(scale=math.nan) or m, ("force", "scale", "finite")),
    "range turned round": (lambda m: m["channels"]["force"].update(range=[5, -5]) or m, ("force", "range", "min < max")),
    "range infinite": (lambda m: m["command"].update(range=[-math.inf, 5.0]) or m, ("command", "range", "finite")),
    "range of one number": (lambda m: m["command"].update(range=[5.0]) or m, ("command", "range")),
    "channel twice": (lambda m: m["channels"]["force"].update(channel=0) or m, ("force", "position", "channel")),
    "channel negative": (lambda m: m["channels"]["force"].update(channel=-1) or m, ("force", "channel", "0")),
    "null beyond the range": (lambda m: m["command"].update(offset=6.0) or m, ("command", "offset", "[-5, 5]")),
    "no channels": (lambda m: m | {"channels": {}}, ("wired", "position")),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_bridge_file(case, content):
    change, words = WRONG[case]
    with pytest.raises(BadInput) as error:
        bridge_from_mapping(change(content), "bridge.yaml")
    assert str(error.value).startswith("bridge.yaml")
    for word in words:
        assert word in str(error.value)


@pytest.fixture
def acme(tmp_path, monkeypatch):
    """Install a distribution that provides a backend, without pip."""
    text = (
        "from typing import NamedTuple\n"
        "class Parameters(NamedTuple):\n    gain: float = 1.0\n"
        "def open(parameters, wiring, period):\n    return (parameters, wiring, period)\n"
    )
    install(tmp_path, {"acme_daq": text}, {BACKENDS.group: {"acme": "acme_daq"}})
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(BACKENDS, "_loaded", {})
    offered.cache_clear()
    yield
    offered.cache_clear()


@pytest.mark.usefixtures("acme")
def test_backend_of_another_distribution(content):
    assert {"acme", "udp", "comedi"} <= set(BACKENDS.names())
    bridge = bridge_from_mapping(content | {"backend": {"name": "acme", "gain": 2}}, "bridge.yaml")
    parameters, wiring, period = bridge.open(1e-3)
    assert (parameters.gain, wiring, period) == (2.0, bridge.calibration.wiring, 1e-3)


def test_without_other_distributions_there_are_three():
    assert BACKENDS.names() == ("comedi", "nidaqmx", "udp")
