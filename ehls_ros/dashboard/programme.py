"""Status line of a running test programme."""

from ehls_ros.dashboard.graph import Health

NODE = "programme_node"
"""Node that runs programmes."""


def programme_line(health: tuple[Health, ...]) -> str:
    """Return title, block, load cycles and state of the programme; empty where none runs.

    Args:
        health: the nodes' diagnostics.
    """
    said = next((node.figures for node in health if node.node == NODE), {})
    if "programme" not in said:
        return ""
    block = f"block {said.get('block', '')} {said.get('block_name', '')}"
    count = f"{said.get('load_cycles', '')} of {said.get('of_load_cycles', '')} load cycles"
    last = f"peak {said['peak']}, valley {said['valley']}" if "peak" in said and "valley" in said else ""
    return " · ".join(filter(None, [said["programme"], block, count, said.get("programme_state", ""), last]))
