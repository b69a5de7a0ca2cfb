"""`hardware_bridge_node`: place of the real rig in the graph. This version has no DAQ backend."""

import sys


def main() -> int:
    """Say what is missing."""
    print(
        "hardware_bridge_node: this version has no DAQ backend; start the simulated rig with plant:=sim (plant_sim_node)",
        file=sys.stderr,
    )
    return 1


if __name__ == "__main__":
    sys.exit(main())
