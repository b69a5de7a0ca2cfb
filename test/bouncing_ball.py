"""A ball on the floor, for compiled integrators: with a restitution its bounces become ever more frequent."""

from ehls_ros.arrays import kernel


@kernel
def evaluate(t, y, mode, c, rate):
    """Height and speed ``y`` under the gravity ``c[0]``; the event is the floor."""
    rate[0] = y[1]
    rate[1] = -c[0]
    return -y[0] if y[1] < 0.0 else -1.0


@kernel
def switch(t, y, mode, c):
    """Bounce with the restitution ``c[1]``."""
    y[1] = -c[1] * y[1]
