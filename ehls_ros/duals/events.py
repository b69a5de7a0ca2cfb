"""Operations on numbers at events of an integrator; for floats they do nothing, at no cost."""

from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import lower_builtin, overload, type_callable

from ehls_ros.duals.code import ONE, CodeDual, any_tangent, chain, intrinsic, number, or_zero, read, written, zeros
from ehls_ros.duals.kinds import DualArrayType, DualType


@intrinsic
def _ticking(typingctx: Any, length: Any) -> Any:
    """Return a length as the variable of the last tangent."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        kind = sig.return_type
        tangents: list[Any] = [zeros(lanes) for lanes in kind.lanes]
        tangents[-1] = ir.Constant(tangents[-1].type, [0.0] * (kind.lanes[-1] - 1) + [1.0])
        return written(context, builder, kind, CodeDual(read(context, builder, length, args[0]).value, tangents))

    return length(length), lower


def _by_length(builder: Any, dual: CodeDual) -> Any:
    """Return the last tangent."""
    last = (dual.tangents or [])[-1]
    return builder.extract_element(last, ir.Constant(ir.IntType(32), last.type.count - 1))


def _without_length(builder: Any, tangents: list[Any]) -> list[Any]:
    """Return tangents with the last one set to zero."""
    last = tangents[-1]
    return [*tangents[:-1], builder.insert_element(last, number(0.0), ir.Constant(ir.IntType(32), last.type.count - 1))]


@intrinsic
def _implied(typingctx: Any, length: Any, event: Any) -> Any:
    """Return a length at which an event function is zero, with the implied tangents; zero ones if it only touches zero."""
    if not isinstance(event, DualType):
        # The system has no events.
        return length(length, event), lambda context, builder, sig, args: args[0]

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        value = read(context, builder, length, args[0]).value
        function = read(context, builder, event, args[1])
        rate = _by_length(builder, function)
        factor = or_zero(builder, builder.fcmp_ordered(">", rate, number(0.0)), builder.fdiv(number(-1.0), rate))
        tangents = chain(builder, (factor, function)) or []
        return written(context, builder, sig.return_type, CodeDual(value, _without_length(builder, tangents)))

    return length(length, event), lower


@intrinsic
def _after(typingctx: Any, value: Any, length: Any) -> Any:
    """Return a value that depends on the step's length, including the tangents of the length."""

    def lower(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        dual, step = (read(context, builder, kind, arg) for kind, arg in zip(sig.args, args, strict=True))
        tangents = chain(builder, (ONE, dual), (_by_length(builder, dual), step)) or []
        return written(context, builder, value, CodeDual(dual.value, _without_length(builder, tangents)))

    return value(value, length), lower


def length_to_event(take_step: Any, evaluate: Any, t: Any, y: Any, mode: Any, c: Any, length: Any, work: Any) -> Any:
    """Return the length of a step that ends on an event; for duals, with the derivatives of the event time.

    They follow from the event function g, which is zero at the event for all parameters: dh/dp = -(dg/dp) / (dg/dh). The state
    at the event, ``work[0]``, receives the change due to the event time. The remainder of the whole step is shortened
    accordingly, so that both parts together have the derivatives at a fixed time. These include the jump known as the saltation
    matrix (Leine, Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, 2004, chapter 7).

    Args:
        take_step: takes a step of the integrator; the result is in ``work[0]``.
        evaluate: rates and event function of the system.
        t: time at the start of the step [s].
        y: state at the start of the step.
        mode: modes during the step.
        c: coefficients of the system.
        length: length of the step [s].
        work: workspace of the integrator.
    """
    return length


_NO_REFCOUNT: Any = {"_nrt": False, "error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
"""Options of :func:`~ehls_ros.arrays.kernel_no_refcount`."""


@overload(length_to_event, strict=False, jit_options=_NO_REFCOUNT)
def _length_to_event(take_step: Any, evaluate: Any, t: Any, y: Any, mode: Any, c: Any, length: Any, work: Any) -> Any:
    if not isinstance(y, DualArrayType):
        return lambda take_step, evaluate, t, y, mode, c, length, work: length

    def differentiated(take_step: Any, evaluate: Any, t: Any, y: Any, mode: Any, c: Any, length: Any, work: Any) -> Any:
        ticking = _ticking(length)
        take_step(t, y, mode, c, ticking, work)
        end = work[0]
        length = _implied(length, evaluate(t + ticking, end, mode, c, work[1]))
        for i in range(y.size):
            end[i] = _after(end[i], length)
        return length

    return differentiated


def as_element(array: Any, number: Any) -> Any:
    """Return a number in the type of the elements of an array: a dual for duals, otherwise unchanged."""
    return number


@type_callable(as_element)
def _as_element(context: Any) -> Any:
    return lambda array, number: array.dtype if isinstance(array, DualArrayType) else number


@lower_builtin(as_element, types.Any, types.Any)
def _(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    return context.cast(builder, args[1], sig.args[1], sig.return_type)


def varies(value: Any) -> bool:
    """Return whether a number has a nonzero derivative; always False for a float."""
    return False


@type_callable(varies)
def _varies(context: Any) -> Any:
    return lambda value: types.boolean


@lower_builtin(varies, types.Any)
def _(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    [kind], [value] = sig.args, args
    if not isinstance(kind, DualType):
        return context.get_constant(types.boolean, False)
    return any_tangent(builder, read(context, builder, kind, value).tangents or [])
