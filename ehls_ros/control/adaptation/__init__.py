"""What a rig file has wrong, found from what a controller measures and commands while it runs.

A regression per stage, as in the identification of recordings: the valve from the commands, the flow from spool, pressure and
position, the area from load cell and pressure, the friction from the reversals. Each estimates how far coefficients are from
those of the rig file; :mod:`ehls_ros.control.adaptation.hand_over` decides which of it the controller is given.
"""
