"""Converter cards under Linux through comedilib, among them Advantech's; docs/hardware.md lists the cards with a driver.

Never exercised on hardware: tested against a stand-in with the library's functions. This computer times the samples and reads
the channels one after another, some 10 us each.
"""

import ctypes
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, NamedTuple

from ehls_ros.errors import BadInput, WorkFailed
from ehls_ros.hardware.backends.base import Channel, Reading, Wiring, permitted
from ehls_ros.hardware.realtime import sleep_until
from ehls_ros.hardware.sample_clock import free_running_time
from ehls_ros.schema import quantity, text

UNIT_VOLT = 0
OUT_OF_RANGE_NUMBER = 0
"""A saturated channel reads the end of its range; comedilib's default is NaN, which would hide the saturation."""

REFERENCES = {"ground": 0, "common": 1, "differential": 2, "other": 3}
"""Comedi's numbers for the reference of an input."""


class Range(ctypes.Structure):
    """comedilib's ``comedi_range``."""

    _fields_ = (("min", ctypes.c_double), ("max", ctypes.c_double), ("unit", ctypes.c_uint))


UINT, INT, DEVICE, RANGE = ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.POINTER(Range)

FUNCTIONS: dict[str, tuple[Any, Sequence[Any]]] = {
    "comedi_open": (DEVICE, (ctypes.c_char_p,)),
    "comedi_close": (INT, (DEVICE,)),
    "comedi_errno": (INT, ()),
    "comedi_strerror": (ctypes.c_char_p, (INT,)),
    "comedi_set_global_oor_behavior": (INT, (INT,)),
    "comedi_get_n_channels": (INT, (DEVICE, UINT)),
    "comedi_get_maxdata": (UINT, (DEVICE, UINT, UINT)),
    "comedi_find_range": (INT, (DEVICE, UINT, UINT, UINT, ctypes.c_double, ctypes.c_double)),
    "comedi_get_range": (RANGE, (DEVICE, UINT, UINT, UINT)),
    "comedi_to_phys": (ctypes.c_double, (UINT, RANGE, UINT)),
    "comedi_from_phys": (UINT, (ctypes.c_double, RANGE, UINT)),
    "comedi_data_read": (INT, (DEVICE, UINT, UINT, UINT, UINT, ctypes.POINTER(UINT))),
    "comedi_data_write": (INT, (DEVICE, UINT, UINT, UINT, UINT, UINT)),
}
"""Result and argument types of the comedilib functions used."""


class Parameters(NamedTuple):
    """The cards' device files and subdevices; the paper's rig has one card for the inputs and one for the output."""

    input_device: Annotated[str, text("device file of the card with the inputs")] = "/dev/comedi0"
    input_subdevice: Annotated[int, quantity("1", "its analog input subdevice", minimum=0, maximum=31)] = 0
    output_device: Annotated[str, text("device file of the card with the output; empty: same as the inputs")] = ""
    output_subdevice: Annotated[int, quantity("1", "its analog output subdevice", minimum=0, maximum=31)] = 1
    reference: Annotated[str, text(f"reference of the inputs: {', '.join(REFERENCES)}")] = "ground"
    library: Annotated[str, text("shared library")] = "libcomedi.so.0"


class Port(NamedTuple):
    """One channel: the leading arguments of comedilib's read and write, and the range for the conversion."""

    device: Any
    subdevice: int
    channel: int
    range: int
    reference: int
    volts: Any
    largest: int


def load_library(name: str) -> ctypes.CDLL:
    """Load comedilib and declare its functions.

    Raises:
        BadInput: it is not installed, or too old.
    """
    where = "backend: comedi"
    try:
        library = ctypes.CDLL(name, use_errno=True)
        for function, (result, arguments) in FUNCTIONS.items():
            found = getattr(library, function)
            found.restype, found.argtypes = result, arguments
    except OSError as error:
        raise BadInput(f"library {name} cannot be loaded ({error})", where, "comedilib installed") from None
    except AttributeError as error:
        raise BadInput(f"library {name} lacks a function ({error})", where, "comedilib 0.8 or later") from None
    return library


class ComediDevice:
    """One or two cards as a device."""

    def __init__(self, parameters: Parameters, wiring: Wiring, period: float) -> None:
        """Open the cards and close the valve."""
        if parameters.reference not in REFERENCES:
            raise BadInput(f"reference is {parameters.reference!r}", "backend: comedi", f"one of {', '.join(REFERENCES)}")
        self._library = load_library(parameters.library)
        self._library.comedi_set_global_oor_behavior(OUT_OF_RANGE_NUMBER)
        self._wiring = wiring
        self._period = period
        self._cards: dict[str, Any] = {}
        self._figures = {"read": 0, "lost": 0, "written": 0}
        self._datum = UINT()
        try:
            reference = REFERENCES[parameters.reference]
            card = self._card(parameters.input_device)
            self._inputs = tuple(self._port(card, parameters.input_subdevice, used, reference) for used in wiring.inputs)
            card = self._card(parameters.output_device or parameters.input_device)
            self._output = self._port(card, parameters.output_subdevice, wiring.output, REFERENCES["ground"])
            self._set(wiring.null)
        except (BadInput, WorkFailed):
            self._close_cards()
            raise
        self._epoch = time.monotonic()
        self._begun = free_running_time()
        self._cycle = -1

    def read(self, timeout: float) -> Reading | None:
        """Sample all inputs when the next period begins; see :class:`~ehls_ros.hardware.backends.base.Device`."""
        now = time.monotonic()
        due = self._epoch + (self._cycle + 1) * self._period
        if due > now + timeout:
            sleep_until(now + timeout)
            return None
        now = sleep_until(due)
        cycle = max(math.floor((now - self._epoch) / self._period), self._cycle + 1)
        self._figures["lost"] += cycle - self._cycle - 1
        self._figures["read"] += 1
        self._cycle = cycle
        sampled = free_running_time() - self._begun
        values = tuple(map(self._get, self._inputs))
        return Reading(cycle, round(1e9 * sampled), values)

    def write(self, value: float, sequence: int) -> None:
        """Set the output; see :class:`~ehls_ros.hardware.backends.base.Device`."""
        self._set(permitted(value, self._wiring))
        self._figures["written"] += 1

    def close(self) -> None:
        """Set the output to null and close the cards."""
        if self._cards:
            try:
                self._set(self._wiring.null)
            finally:
                self._close_cards()

    def figures(self) -> Mapping[str, int]:
        """Return counts: samples read, samples missed because this computer was late, outputs written."""
        return dict(self._figures)

    def _card(self, path: str) -> Any:
        if path not in self._cards:
            card = self._library.comedi_open(path.encode())
            if not card:
                raise WorkFailed(f"{path} cannot be opened ({self._reason()})")
            self._cards[path] = card
        return self._cards[path]

    def _port(self, card: Any, subdevice: int, channel: Channel, reference: int) -> Port:
        where = f"backend: comedi: subdevice {subdevice}"
        count = self._library.comedi_get_n_channels(card, subdevice)
        if channel.number >= count:
            raise BadInput(f"channel is {channel.number}", where, f"a number below {max(count, 0)}, the number of channels")
        low, high = channel.range
        index = self._library.comedi_find_range(card, subdevice, channel.number, UNIT_VOLT, low, high)
        if index < 0:
            raise BadInput(f"range is [{low:g}, {high:g}] V", where, "a range within one of the card's")
        volts = self._library.comedi_get_range(card, subdevice, channel.number, index)
        largest = self._library.comedi_get_maxdata(card, subdevice, channel.number)
        return Port(card, subdevice, channel.number, index, reference, volts, largest)

    def _get(self, port: Port) -> float:
        self._check(self._library.comedi_data_read(*port[:5], ctypes.byref(self._datum)), "read")
        volts: float = self._library.comedi_to_phys(self._datum, port.volts, port.largest)
        return volts

    def _set(self, volts: float) -> None:
        port = self._output
        datum = self._library.comedi_from_phys(volts, port.volts, port.largest)
        self._check(self._library.comedi_data_write(*port[:5], datum), "written")

    def _check(self, result: int, what: str) -> None:
        if result < 0:
            raise WorkFailed(f"a channel of the card cannot be {what} ({self._reason()})")

    def _reason(self) -> str:
        message: bytes = self._library.comedi_strerror(self._library.comedi_errno()) or b"no reason given"
        return message.decode(errors="replace")

    def _close_cards(self) -> None:
        close: Callable[[Any], int] = self._library.comedi_close
        while self._cards:
            close(self._cards.popitem()[1])


def open(parameters: Parameters, wiring: Wiring, period: float) -> ComediDevice:  # noqa: A001
    """Open the cards with the valve closed.

    Raises:
        BadInput: comedilib is not installed, or the card does not have a channel or range.
        WorkFailed: a card cannot be opened.
    """
    return ComediDevice(parameters, wiring, period)
