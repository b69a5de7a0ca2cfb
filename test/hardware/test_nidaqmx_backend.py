"""The nidaqmx backend against a stand-in for the package."""

import contextlib
import enum
import math
import re
import sys
import types

import pytest

from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.extras import install_command
from ehls_ros.hardware.backends import BACKENDS
from ehls_ros.hardware.backends.base import Channel, Wiring

NIDAQMX = BACKENDS.load("nidaqmx")
WIRING = Wiring((Channel(5, (-10.0, 10.0)), Channel(2, (-5.0, 5.0))), Channel(1, (-5.0, 5.0)), 0.5)
PERIOD = 1e-3


class DaqError(Exception):
    def __init__(self, message, error_code):
        super().__init__(message)
        self.error_code = error_code


class TerminalConfiguration(enum.Enum):
    DEFAULT = -1
    DIFF = 10106


class AcquisitionType(enum.Enum):
    CONTINUOUS = 10123


class Card:
    """State shared by the tasks: samples in the buffer, voltages written, calls in order."""

    def __init__(self):
        self.waiting, self.written, self.calls, self.open, self.refuses = [], [], [], 0, None

    def call(self, name, *arguments, **named):
        if name == self.refuses:
            raise DaqError("card says no\nmore of it", -200220)
        self.calls.append((name, arguments, named))

    def arguments_of(self, name):
        return [(arguments, named) for called, arguments, named in self.calls if called == name]


def package(card):
    """Return modules with the functions the backend uses."""

    class Task:
        def __init__(self):
            card.open += 1
            # Argument names and defaults as in the package, so that a wrong call fails.
            self.ai_channels = types.SimpleNamespace(add_ai_voltage_chan=self._input)
            self.ao_channels = types.SimpleNamespace(add_ao_voltage_chan=self._output)
            self.timing = types.SimpleNamespace(cfg_samp_clk_timing=self._timing)
            self.in_stream = Stream()

        def _input(self, physical_channel, name="", terminal_config=None, min_val=-5.0, max_val=5.0):
            card.call("input", physical_channel, terminal_config.name, min_val, max_val)

        def _output(self, physical_channel, name="", min_val=-10.0, max_val=10.0):
            card.call("output", physical_channel, min_val, max_val)

        def _timing(self, rate, source="", active_edge=None, sample_mode=None, samps_per_chan=1000):
            card.call("timing", rate, sample_mode, samps_per_chan)

        def start(self):
            card.call("start")

        def write(self, data, auto_start=None, timeout=10.0):
            card.call("write", data, auto_start)
            card.written.append(data)

        def close(self):
            card.open -= 1

    class Stream:
        @property
        def avail_samp_per_chan(self):
            return len(card.waiting)

    class Reader:
        def __init__(self, task_in_stream):
            assert isinstance(task_in_stream, Stream)

        def read_one_sample(self, data, timeout=10):
            card.call("read", timeout)
            if not card.waiting:
                raise DaqError("not yet", -200284)
            data[:] = card.waiting.pop(0)

        def read_many_sample(self, data, number_of_samples_per_channel=-1, timeout=10.0):
            assert data.shape == (2, number_of_samples_per_channel)
            for column in range(number_of_samples_per_channel):
                data[:, column] = card.waiting.pop(0)
            return number_of_samples_per_channel

    modules = {
        "nidaqmx": types.ModuleType("nidaqmx"),
        "nidaqmx.constants": types.SimpleNamespace(
            TerminalConfiguration=TerminalConfiguration, AcquisitionType=AcquisitionType
        ),
        "nidaqmx.errors": types.SimpleNamespace(DaqError=DaqError),
        "nidaqmx.stream_readers": types.SimpleNamespace(AnalogMultiChannelReader=Reader),
    }
    modules["nidaqmx"].Task = Task
    for name, module in modules.items():
        setattr(modules["nidaqmx"], name.rpartition(".")[2], module)
    return modules


@pytest.fixture
def card(monkeypatch):
    made = Card()
    for name, module in package(made).items():
        monkeypatch.setitem(sys.modules, name, module)
    yield made
    assert made.open == 0


@pytest.fixture
def device(card):
    with contextlib.closing(NIDAQMX.open(NIDAQMX.Parameters("PXI1Slot2", "DIFF"), WIRING, PERIOD)) as made:
        yield made


def test_tasks_are_set_up_with_the_valve_closed_first(card, device):
    names = [name for name, _, _ in card.calls]
    assert names == ["output", "write", "input", "input", "timing", "start"]
    assert card.arguments_of("output") == [(("PXI1Slot2/ao1", -5.0, 5.0), {})]
    assert [arguments for arguments, _ in card.arguments_of("input")] == [
        ("PXI1Slot2/ai5", "DIFF", -10.0, 10.0),
        ("PXI1Slot2/ai2", "DIFF", -5.0, 5.0),
    ]
    [(timing, _)] = card.arguments_of("timing")
    assert timing == (1000.0, AcquisitionType.CONTINUOUS, 1000)
    assert card.written == [0.5]


def test_newest_of_the_waiting_samples(card, device):
    card.waiting = [(1.0, 2.0)]
    assert device.read(0.25)[:3:2] == (0, (1.0, 2.0))
    assert card.arguments_of("read")[-1] == ((0.25,), {})
    card.waiting = [(float(number), -float(number)) for number in range(150)]
    assert device.read(0.25)[:3:2] == (150, (149.0, -149.0))
    assert device.figures()["skipped"] == 149


def test_nothing_yet(card, device):
    assert device.read(0.01) is None
    card.waiting = [(1.0, 2.0)]
    assert device.read(0.01).sequence == 0


@pytest.mark.parametrize(("asked", "set_to"), [(1.5, 1.5), (8.0, 5.0), (-1e30, -5.0), (math.nan, 0.5), (math.inf, 0.5)])
def test_output_stays_within_the_range(card, device, asked, set_to):
    device.write(asked, 0)
    assert card.written[-1] == set_to


def test_close_closes_the_valve_once(card, device):
    device.write(4.0, 0)
    device.close()
    device.close()
    assert card.written == [0.5, 4.0, 0.5]


def test_lost_card(card, device):
    card.refuses = "read"
    with pytest.raises(WorkFailed, match=r"cannot be read \(card says no\)$"):
        device.read(0.1)
    card.refuses = "write"
    with pytest.raises(WorkFailed, match="cannot be written"):
        device.write(1.0, 0)
    with pytest.raises(WorkFailed):
        device.close()


@pytest.mark.parametrize("refused", ["output", "write", "input", "timing", "start"])
def test_refusal_while_opening_leaves_nothing_open(card, refused):
    card.refuses = refused
    with pytest.raises(WorkFailed, match=r"Dev1 cannot be set up \(card says no\)"):
        NIDAQMX.open(NIDAQMX.Parameters(), WIRING, PERIOD)


@pytest.mark.usefixtures("card")
def test_unknown_terminals():
    with pytest.raises(BadInput, match=r"terminals is 'XYZ'.*DIFF"):
        NIDAQMX.open(NIDAQMX.Parameters(terminals="XYZ"), WIRING, PERIOD)


def test_package_that_is_not_installed(monkeypatch):
    monkeypatch.setitem(sys.modules, "nidaqmx", None)
    with pytest.raises(BadInput, match=re.escape(install_command("nidaqmx"))):
        NIDAQMX.open(NIDAQMX.Parameters(), WIRING, PERIOD)
