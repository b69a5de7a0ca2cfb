"""Adapt the coefficients of a rig file from the readings and commands of a running controller.

There is one regression per stage, as in the identification of recordings: the valve from the commands, the flow from spool,
pressure and position, the area from load cell and pressure, the friction from the reversals. Each estimates deviations from the
rig file's coefficients; :mod:`ehls_ros.control.adaptation.correction` decides which of them the controller receives.
"""
