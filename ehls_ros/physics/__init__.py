"""The rig's physics: rig description, plant, friction, effects, integration, sensors."""
