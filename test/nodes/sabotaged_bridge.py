"""The hardware bridge with two more services.

`sabotage` hangs for some seconds (false) or ends the service thread (true); `break_loop` makes the loop raise an exception.
"""

import threading

from std_srvs.srv import SetBool, Trigger

from ehls_ros.nodes.hardware_bridge_node import HardwareBridgeNode
from ehls_ros.nodes.running import run_node

HANGS = 5.0
"""Time the service hangs; far longer than the gate tolerates [s]."""


class SabotagedBridge(HardwareBridgeNode):
    """A bridge whose services fail in ways no request could cause."""

    def __init__(self) -> None:
        super().__init__()
        self.create_service(SetBool, "sabotage", self.sabotage)
        self.create_service(Trigger, "break_loop", self.break_loop)
        self.never = threading.Event()
        self.broken = False

    def break_loop(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self.broken = response.success = True
        return response

    def once(self) -> None:
        super().once()
        if self.broken:
            raise ZeroDivisionError

    def sabotage(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data:
            raise SystemExit(3)
        print("hangs", flush=True)
        self.never.wait(HANGS)
        return response


if __name__ == "__main__":
    run_node(SabotagedBridge)
