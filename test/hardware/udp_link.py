"""Bridge and target on one link in one thread, for the tests."""

import socket
import time

from patience import PATIENCE

from ehls_ros.hardware.backends import BACKENDS
from ehls_ros.hardware.backends.base import Channel, Wiring
from ehls_ros.hardware.packet import Codec, Status
from ehls_ros.hardware.target import Target

UDP = BACKENDS.load("udp")
WIRING = Wiring((Channel(2, (-10.0, 10.0)), Channel(0, (-10.0, 10.0))), Channel(0, (-5.0, 5.0)), 0.5)
VALUES = (1.0, 2.0, 3.0)
PERIOD = 1e-3


class TargetEnd:
    """A target on a separate socket, stepped by hand."""

    def __init__(self, key=b""):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)
        self.address = self.socket.getsockname()
        self.seen = []
        self.restart(key)

    def restart(self, key=b""):
        self.target = Target(Codec(key), PERIOD, WIRING.null)

    def take(self, now=0.0, cycle=0):
        """Let the target process the packets that have arrived."""
        for data, sender in self.waiting():
            self.target.receive(data, sender, now, cycle)

    def waiting(self):
        try:
            while True:
                self.seen.append(self.socket.recvfrom(2048))
                yield self.seen[-1]
        except BlockingIOError:
            return

    def measure(self, cycle, values=VALUES, status=Status.COMMANDED, now=None):
        """Send the measurement of a cycle and return its bytes."""
        data = self.target.measurement(cycle, 1000 * cycle, status, values, now)
        self.socket.sendto(data, self.target.address)
        return data


def opened(end, **parameters):
    return UDP.open(UDP.Parameters(port=end.address[1], **parameters), WIRING, PERIOD)


def greeted(end, device, now=0.0):
    """Make the device greet the target and the target process the hello."""
    deadline = time.monotonic() + PATIENCE
    end.target.greeted = False
    while not end.target.greeted:
        assert time.monotonic() < deadline
        device.read(1e-3)
        end.take(now)
