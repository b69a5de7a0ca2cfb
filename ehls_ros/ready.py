"""Makes numba ready to load compiled functions, by being imported: processes forked afterwards need not do it again.

Numba imports much of itself, and SciPy's linear algebra, when a process first compiles or loads a function.
"""

from numba.core.registry import cpu_target

cpu_target.typing_context.refresh()
cpu_target.target_context.refresh()
