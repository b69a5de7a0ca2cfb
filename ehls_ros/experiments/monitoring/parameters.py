"""Parameters of the monitoring of a rig."""

from typing import Annotated, NamedTuple

from ehls_ros.schema import quantity


class Parameters(NamedTuple):
    """Parameters of the monitoring of a rig."""

    mean_time_between_false_alarms: Annotated[
        float, quantity("h", "mean time between two false alarms, at least", minimum=1.0, maximum=1e6)
    ] = 1000.0
    learning_time: Annotated[
        float, quantity("s", "time from which the scatter of a healthy rig is learnt, without a baseline", minimum=30.0)
    ] = 60.0
    reading_time: Annotated[float, quantity("s", "time over which coefficients are averaged", minimum=10.0, maximum=3600.0)] = (
        60.0
    )
    kept_time: Annotated[
        float,
        quantity("s", "time for which samples are kept, for a diagnosis and the flight recorder", minimum=30.0, maximum=600.0),
    ] = 120.0
