"""Run the named effects without compiling, neutral and not, and print as JSON their differences from the rig without them.

Uncompiled, because compiling one kernel takes longer than running all of them; started with ``NUMBA_DISABLE_JIT=1``.
"""

import itertools
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from rig_runs import rig_file_for

from ehls_ros.physics.effects import EFFECTS
from ehls_ros.physics.rig import Rig, rig_from_mapping
from ehls_ros.physics.simulator import Simulator
from ehls_ros.schema import declarations

PLANT_STATES = 7
"""Those of both plants that are compared."""

MOST_TURNS = 6
"""Most parameters that move up or down on their own."""


def motion(rig: Rig, cycles: int) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Return states and readings of a motion that reverses, loads both ways and moves the position servo."""
    simulator = Simulator(rig, 1e-3, 5e-4)
    rows = []
    for k in range(cycles):
        t = k * 1e-3
        simulator.advance(
            1.2e-3 * math.sin(60.0 * t),
            3e3 * math.sin(45.0 * t),
            135e3 * math.cos(45.0 * t),
            5e-3 * math.sin(30.0 * t),
            0.15 * math.cos(30.0 * t),
        )
        rows.append(np.concatenate([simulator.y[:PLANT_STATES], simulator.measure(np.zeros(len(rig.sensed)))]))
    return np.array(rows)


def other_values(effect: Any) -> Iterator[dict[str, float]]:
    """Yield settings off the neutral one, all parameters moved at once, each up or down: ever further, last to the bounds.

    Bounds come last since an effect may be so stiff there that it runs for long. Of many parameters, several move alike.
    """
    parameters = list(declarations(effect.Parameters))
    turns = min(len(parameters), MOST_TURNS)
    for parts in ((0.02, 0.2, 0.6), (1.0,)):
        for directions, part in itertools.product(itertools.product((True, False), repeat=turns), parts):
            setting = {}
            for declared, upward in zip(parameters, itertools.cycle(directions), strict=False):
                bound = declared.maximum if upward else declared.minimum
                if bound is None:
                    bound = declared.default + (1.0 if upward else -1.0)
                setting[declared.name] = declared.default + part * (bound - declared.default)
            yield setting


def main(*names: str) -> None:
    found, motions = {}, dict[Path, np.ndarray[Any, np.dtype[np.float64]]]()
    for name in names:
        effect, rig_file = EFFECTS.load(name), rig_file_for(name)
        data = yaml.safe_load(rig_file.read_text(encoding="utf-8"))
        if rig_file not in motions:
            motions[rig_file] = motion(rig_from_mapping(data, str(rig_file)), 200)
        plain = motions[rig_file]
        neutral = rig_from_mapping({**data, "effects": [{"name": name}]}, str(rig_file))
        changed_by = None
        for setting in other_values(effect):
            try:
                rig = rig_from_mapping({**data, "effects": [{"name": name, **setting}]}, str(rig_file))
            except ValueError:
                continue
            with np.errstate(all="ignore"):
                rows = motion(rig, 200)
            if not np.array_equal(rows, plain) and np.all(np.isfinite(rows)):
                changed_by = setting
                break
        found[name] = {"neutral_is_neutral": bool(np.array_equal(motion(neutral, 200), plain)), "changed_by": changed_by}
    print(json.dumps(found))


if __name__ == "__main__":
    main(*sys.argv[1:])
