"""The comedi backend against a stand-in for comedilib, compiled here."""

import contextlib
import ctypes
import math
import shutil
import subprocess
import time
from pathlib import Path

import pytest

from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.hardware.backends import BACKENDS
from ehls_ros.hardware.backends.base import Channel, Wiring

COMEDI = BACKENDS.load("comedi")
SOURCE = Path(__file__).with_name("comedi_stub.c")
WIRING = Wiring((Channel(5, (-10.0, 10.0)), Channel(2, (-5.0, 5.0))), Channel(1, (-5.0, 5.0)), 0.5)
PERIOD, LONG = 2e-3, 3600.0


def code(volts):
    """Return the output's code, 16 bits over +-10 V."""
    return round((volts + 10.0) / 20.0 * 65535)


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """Compile the library."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler to make the stand-in for comedilib with")
    path = tmp_path_factory.mktemp("comedi") / "libcomedi_stub.so"
    subprocess.run([compiler, "-shared", "-fPIC", "-w", "-o", path, SOURCE, "-lm"], check=True)
    return path


@pytest.fixture
def library(compiled, tmp_path):
    """Give each test a separate copy of the library, so that tests share no state."""
    return shutil.copy(compiled, tmp_path)


@pytest.fixture
def stub(library):
    return ctypes.CDLL(str(library))


def seen(stub, name):
    return ctypes.c_uint.in_dll(stub, name).value


@pytest.fixture
def parameters(library):
    changes = {"reference": "differential", "library": str(library), "output_subdevice": 0}
    return COMEDI.Parameters("/dev/stub0", 0, "/dev/stub1")._replace(**changes)


@pytest.fixture
def device(stub, parameters):
    with contextlib.closing(COMEDI.open(parameters, WIRING, PERIOD)) as made:
        yield made


def test_open_closes_the_valve(stub, device):
    assert (seen(stub, "stub_written"), seen(stub, "stub_channel")) == (code(0.5), 1)


def test_reading_is_in_volts_in_the_wiring_s_order(stub, device):
    codes = (ctypes.c_uint * 16).in_dll(stub, "stub_codes")
    codes[5], codes[2] = 3072, 1024
    reading = device.read(1.0)
    assert reading.values == pytest.approx((3072 / 4095 * 20 - 10, 1024 / 4095 * 20 - 10))
    assert seen(stub, "stub_reference") == 2


def test_a_saturated_channel_reads_the_end_of_its_range(stub, device):
    (ctypes.c_uint * 16).in_dll(stub, "stub_codes")[5] = 4095
    assert device.read(1.0).values == (10.0, -10.0)


def test_samples_come_each_period_and_late_reads_leave_gaps(device):
    begin = time.monotonic()
    numbers = [device.read(1.0).sequence for _ in range(5)]
    assert time.monotonic() - begin >= 3 * PERIOD
    assert numbers == sorted(set(numbers))
    time.sleep(5 * PERIOD)
    after = device.read(1.0)
    assert after.sequence > numbers[-1] + 2
    assert device.figures()["lost"] >= after.sequence - 5
    assert after.time_ns == pytest.approx(1e9 * PERIOD * after.sequence, abs=1e9)


def test_timeout_before_the_next_sample(parameters):
    with contextlib.closing(COMEDI.open(parameters, WIRING, LONG)) as device:
        assert device.read(0.0).sequence == 0
        begin = time.monotonic()
        assert device.read(0.02) is None
        # It did not wait for the sample, due in an hour.
        assert 0.02 <= time.monotonic() - begin < LONG


@pytest.mark.parametrize(("asked", "set_to"), [(1.5, 1.5), (8.0, 5.0), (-1e30, -5.0), (math.nan, 0.5), (-math.inf, 0.5)])
def test_output_stays_within_the_range(stub, device, asked, set_to):
    device.write(asked, 0)
    assert seen(stub, "stub_written") == code(set_to)


def test_close_closes_the_valve_and_the_cards_once(stub, device):
    device.write(4.0, 0)
    device.close()
    writes = seen(stub, "stub_writes")
    device.close()
    assert seen(stub, "stub_written") == code(0.5)
    assert seen(stub, "stub_writes") == writes == 3
    assert stub.stub_open() == 0


def test_lost_card(stub, device):
    broken = ctypes.c_int.in_dll(stub, "stub_broken")
    broken.value = 1
    with pytest.raises(WorkFailed, match="stub error"):
        device.read(1.0)
    with pytest.raises(WorkFailed, match="stub error"):
        device.write(0.0, 0)
    with pytest.raises(WorkFailed):
        device.close()
    assert stub.stub_open() == 0
    broken.value = 0


@pytest.mark.parametrize(
    ("change", "wiring", "error", "words"),
    [
        ({"input_device": "/dev/none"}, WIRING, WorkFailed, "/dev/none"),
        ({"output_device": "/dev/none"}, WIRING, WorkFailed, "/dev/none"),
        ({"output_subdevice": 7}, WIRING, BadInput, "subdevice 7"),
        ({"reference": "earth"}, WIRING, BadInput, "earth"),
        ({"library": "libnone.so"}, WIRING, BadInput, "libnone.so"),
        ({}, WIRING._replace(inputs=(Channel(16, (-10.0, 10.0)),)), BadInput, "channel is 16"),
        ({}, WIRING._replace(inputs=(Channel(0, (-20.0, 20.0)),)), BadInput, r"range is \[-20, 20\]"),
        ({}, WIRING._replace(output=Channel(2, (-5.0, 5.0))), BadInput, "channel is 2"),
    ],
)
def test_a_failed_open_leaves_nothing_open(stub, parameters, change, wiring, error, words):
    with pytest.raises(error, match=words):
        COMEDI.open(parameters._replace(**change), wiring, PERIOD)
    assert stub.stub_open() == 0
    assert seen(stub, "stub_writes") == 0
