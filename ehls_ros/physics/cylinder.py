"""Double-rod cylinder: the volume balance (2)."""

from ehls_ros.arrays import kernel
from ehls_ros.physics.parameters import Plant


@kernel
def load_pressure_rate(
    load_flow: float, velocity: float, load_pressure: float, leakage: float, bulk_modulus: float, plant: Plant
) -> float:
    """Return the rate of the load pressure, equation (2) solved for it.

    Args:
        load_flow: QL [m^3/s].
        velocity: piston velocity [m/s].
        load_pressure: pL [Pa].
        leakage: leakage flow beyond the laminar Ctc pL [m^3/s].
        bulk_modulus: effective bulk modulus [Pa].
        plant: the rig's coefficients.

    Returns:
        dpL/dt [Pa/s].
    """
    stored = load_flow - plant.piston_area * velocity - plant.leakage_coefficient * load_pressure - leakage
    return 4.0 * bulk_modulus / plant.total_volume * stored  # (2)
