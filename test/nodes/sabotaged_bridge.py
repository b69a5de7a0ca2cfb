"""The hardware bridge with a service more, `sabotage`: it does not answer (false), or ends the thread of services (true)."""

import threading

from std_srvs.srv import SetBool

from ehls_ros.nodes.control import run_node
from ehls_ros.nodes.hardware_bridge_node import HardwareBridgeNode


class SabotagedBridge(HardwareBridgeNode):
    """Whose services fail in ways that no request can bring about."""

    def __init__(self) -> None:
        super().__init__()
        self.create_service(SetBool, "sabotage", self.sabotage)
        self.never = threading.Event()

    def sabotage(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        if request.data:
            raise SystemExit(3)
        self.never.wait(8.0)
        return response


if __name__ == "__main__":
    run_node(SabotagedBridge)
