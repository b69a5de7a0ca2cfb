"""The promises of the documentation as temporal policies, and the monitor that judges the logs of tests and benchmarks by them.

They are here and not in the package because they judge the true motion of an emulated rig, which no real rig can tell.
:mod:`policies.trace` is a log with all that was asked and heard meanwhile, :mod:`policies.temporal` the formulas,
:mod:`policies.of_gate` and :mod:`policies.of_graph` the policies, and :mod:`policies.monitor` evaluates them.
"""
