"""The topics of a run: name, ROS type, and the trajectory's signal for each message field."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

NAMESPACE = "/ehls"
"""Default namespace of the graph."""


class Topic(NamedTuple):
    """One topic.

    Attributes:
        name: name below the namespace, or an absolute name.
        type: ROS message type.
        signals: names in :data:`ehls_ros.trajectory.SIGNALS` by message field, in the same units.
    """

    name: str
    type: str
    signals: Mapping[str, str] = MappingProxyType({})

    def resolve(self, namespace: str = NAMESPACE) -> str:
        """Return the full name, as ROS resolves it in a namespace."""
        return self.name if self.name.startswith("/") else f"{namespace.rstrip('/')}/{self.name}"


LOADER_STATE = Topic(
    "loader_state",
    "ehls_msgs/msg/LoaderState",
    {
        "position": "position_m",
        "velocity": "velocity_m_s",
        "load_pressure": "load_pressure_pa",
        "spool_position": "spool_m",
        "force": "force_n",
        "supply_pressure": "supply_pressure_pa",
        "oil_temperature": "oil_temperature_k",
    },
)
FORCE_REFERENCE = Topic(
    "force_reference",
    "ehls_msgs/msg/ForceReference",
    {
        "force": "force_reference_n",
        "force_rate": "force_reference_rate_n_s",
        "force_acceleration": "force_reference_acceleration_n_s2",
    },
)
POSITION_REFERENCE = Topic(
    "position_reference",
    "ehls_msgs/msg/PositionReference",
    {
        "position": "position_reference_m",
        "velocity": "position_reference_rate_m_s",
        "acceleration": "position_reference_acceleration_m_s2",
    },
)
REFERENCE_TOPICS: Mapping[str, Topic] = MappingProxyType({"force": FORCE_REFERENCE, "position": POSITION_REFERENCE})
"""The reference topic by the quantity that the controller follows; a run has one of them."""

DISTURBANCE = Topic(
    "disturbance",
    "ehls_msgs/msg/Disturbance",
    {
        "force": "disturbance_force_n",
        "force_rate": "disturbance_force_rate_n_s",
        "displacement": "disturbance_displacement_m",
        "velocity": "disturbance_velocity_m_s",
    },
)
FRICTION_ESTIMATE = Topic(
    "friction_estimate",
    "ehls_msgs/msg/FrictionEstimate",
    {
        "gms_force": "friction_gms_n",
        "viscous_force": "friction_viscous_n",
        "element_forces": "friction_elements_n",
        "slipping": "friction_slipping",
    },
)
VALVE_COMMAND = Topic("valve_command", "ehls_msgs/msg/ValveCommand", {"spool": "valve_command_m"})
CONTROLLER_STATUS = Topic(
    "controller_status",
    "ehls_msgs/msg/ControllerStatus",
    {
        "e3": "e3_mpa",
        "s": "s_mpa_s",
        "alpha": "alpha",
        "beta": "beta",
        "delta": "delta_n",
        "u1": "u1",
        "u2": "u2",
        "u3": "u3",
        "force_error": "force_error_n",
        "force_bound": "force_bound_n",
        "saturated": "saturated",
        "friction_fallback": "friction_fallback",
    },
)

CYCLE_TOPICS = (
    LOADER_STATE,
    FORCE_REFERENCE,
    POSITION_REFERENCE,
    DISTURBANCE,
    FRICTION_ESTIMATE,
    VALVE_COMMAND,
    CONTROLLER_STATUS,
)
"""The topics that make up a trajectory, in the order of a control cycle; every message has a header and a cycle."""

DRIVING = Topic("driving", "std_msgs/msg/Bool")
"""Whether commands reach the valve; published on change."""

TELEMETRY_TOPICS = (
    DRIVING,
    Topic("force", "std_msgs/msg/Float64"),
    Topic("load_pressure", "sensor_msgs/msg/FluidPressure"),
    Topic("joint_states", "sensor_msgs/msg/JointState"),
    Topic("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
)
"""Recorded for standard tools; the cycle topics contain the same data."""

TOPICS = (*CYCLE_TOPICS, *TELEMETRY_TOPICS)

RESPONSE = "response_s"
"""The one signal that is not a message field: time from sending a cycle's snapshot to sending its valve command [s]."""
