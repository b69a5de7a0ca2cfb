"""The documented guarantees as temporal policies, and the monitor that evaluates the logs of tests and benchmarks with them.

They are here and not in the package because they evaluate the true motion of an emulated rig, unobservable on a real one.
:mod:`policies.trace` is a log with all requests and messages, :mod:`policies.temporal` the formulas,
:mod:`policies.of_gate` and :mod:`policies.of_graph` the policies, and :mod:`policies.monitor` evaluates them.
"""
