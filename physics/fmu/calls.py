"""An FMU's functions called by address from compiled code.

What a process has loaded stands in one registry, whose address is a symbol to the linker. Compiled code names the
symbol and an FMU's key, never an address. So what is compiled in one process is of use in the next.

Each FMU has a table of 64-bit words: HEAD words about it, then one row for each of its instances. A row begins with
BUSY, HANDLE and READY; the parameters with which the instance was initialised follow. Threads share the instances. A
thread takes one by a compare-and-swap of its BUSY.

An FMU for co-simulation stays in initialisation mode. There its states can be set like inputs, and their derivatives
read like outputs. Only one that tells none is stepped, by ``run``.
"""

from __future__ import annotations

import numpy as np
from llvmlite import binding, ir
from numba import carray, njit, types
from numba.core import cgutils
from numba.extending import intrinsic

SYMBOL = "twinbench_fmus"
MOST_FMUS = 64
"""FMUs in one process."""
REGISTRY = np.zeros((MOST_FMUS, 2), np.int64)
"""Key and address of the table of each."""
binding.add_symbol(SYMBOL, REGISTRY.ctypes.data)

(VERSION, EXCHANGE, INSTANCES, STATES, INPUTS, OUTPUTS, PARAMETERS, EVENTS) = range(8)
"""Places in the head of a table: FMI's version, 0 of an FMU for co-simulation, then sizes."""
(OF_STATES, OF_RATES, OF_INPUTS, OF_OUTPUTS, OF_PARAMETERS) = range(8, 13)
"""Places of the addresses of value references."""
FUNCTIONS = (
    "set_reals", "get_reals", "set_states", "get_rates", "reset", "setup", "enter_initialisation",
    "leave_initialisation", "enter_event_mode", "update_discrete", "enter_continuous_mode", "get_states", "do_step",
)  # fmt: skip
(
    SET_REALS, GET_REALS, SET_STATES, GET_RATES, RESET, SETUP, ENTER_INIT, EXIT_INIT, ENTER_EVENT, UPDATE, ENTER_CONT,
    GET_STATES, DO_STEP,
) = range(13, 26)  # fmt: skip
"""Places of the functions' addresses."""
JUMPED, TIMED, BEGINS = 26, 27, 28
"""Places where it is noted that the states jumped at an event, that the FMU has a timetable of events, and the time,
as a double, at which instances begin."""
HEAD = 29
BUSY, HANDLE, READY, THETA = 0, 1, 2, 3
WORST, ERROR = 1, 3
"""Worst status with which a call's result still counts, a warning; and FMI's status of an error."""
MOST_UPDATES = 10
"""Most turns of an event iteration; relations that have not settled by then do not."""


@intrinsic
def _registry(typingctx):  # type: ignore[no-untyped-def]
    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        module = builder.module
        symbol = module.globals.get(SYMBOL) or ir.GlobalVariable(module, ir.IntType(8), SYMBOL)
        symbol.linkage = "external"
        return builder.ptrtoint(symbol, ir.IntType(64))

    return types.int64(), generate


@intrinsic
def _as_ints(typingctx, address):  # type: ignore[no-untyped-def]
    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.inttoptr(arguments[0], ir.IntType(64).as_pointer())

    return types.CPointer(types.int64)(types.int64), generate


@intrinsic
def _as_doubles(typingctx, address):  # type: ignore[no-untyped-def]
    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.inttoptr(arguments[0], ir.DoubleType().as_pointer())

    return types.CPointer(types.float64)(types.int64), generate


@intrinsic
def _swapped(typingctx, address, old, new):  # type: ignore[no-untyped-def]
    """1 if the word at an address was ``old`` and is ``new`` now."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        place = builder.inttoptr(arguments[0], ir.IntType(64).as_pointer())
        result = builder.cmpxchg(place, arguments[1], arguments[2], "acq_rel", "monotonic")
        return builder.zext(builder.extract_value(result, 1), ir.IntType(64))

    return types.int64(types.int64, types.int64, types.int64), generate


@intrinsic
def _call(typingctx, address, given):  # type: ignore[no-untyped-def]
    """Call the C function at an address; it returns an int."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        kinds = [context.get_value_type(kind) for kind in given.types]
        function = builder.inttoptr(arguments[0], ir.FunctionType(ir.IntType(32), kinds).as_pointer())
        return builder.call(function, cgutils.unpack_tuple(builder, arguments[1], len(given.types)))

    return types.int32(types.int64, given), generate


@njit(cache=True)
def _table(key):  # type: ignore[no-untyped-def]
    """Address of the table of an FMU."""
    known = carray(_as_ints(_registry()), (MOST_FMUS, 2))
    for k in range(MOST_FMUS):
        if known[k, 0] == key:
            return known[k, 1]
    return 0


@njit(cache=True)
def _reals(head, function, handle, references, count, values):  # type: ignore[no-untyped-def]
    """Set or get so many reals at an address; FMI 3 wants to know the number of values, too. Returns the status."""
    if count == 0:
        return 0
    if head[VERSION] == 2:
        return _call(head[function], (handle, head[references], count, values))
    return _call(head[function], (handle, head[references], count, values, count))


@njit(cache=True)
def _update(head, handle):  # type: ignore[no-untyped-def]
    """Iterate the event that the instance is in, until its relations have settled. Returns the worst status."""
    info = np.zeros(6, np.int64)
    flags, worst, at = info.view(np.int32), 0, info.ctypes.data
    for _ in range(MOST_UPDATES):
        info[:] = 0
        if head[VERSION] == 2:
            worst = max(worst, _call(head[UPDATE], (handle, at)))
            again, jumped, timed = flags[0] != 0, flags[3] != 0, flags[4] != 0
        else:
            where = (handle, at, at + 8, at + 16, at + 24, at + 32, at + 40)
            worst = max(worst, _call(head[UPDATE], where))
            again, jumped, timed = (info[0] & 1) != 0, (info[3] & 1) != 0, (info[4] & 1) != 0
        head[TIMED] |= timed
        if jumped:
            head[JUMPED] = 1
            return ERROR
        if not again:
            return worst
    return ERROR


@njit(cache=True)
def _initialise(head, handle, theta):  # type: ignore[no-untyped-def]
    """Begin anew with these parameters. Returns the worst status."""
    no, zero, begins = np.int32(0), 0.0, head.view(np.float64)[BEGINS]
    worst = _call(head[RESET], (handle,))
    if head[VERSION] == 2:
        worst = max(worst, _call(head[SETUP], (handle, no, zero, begins, no, zero)))
    worst = max(worst, _reals(head, SET_REALS, handle, OF_PARAMETERS, head[PARAMETERS], theta.ctypes.data))
    if head[VERSION] == 2:
        worst = max(worst, _call(head[ENTER_INIT], (handle,)))
    else:
        worst = max(worst, _call(head[ENTER_INIT], (handle, no, zero, begins, no, zero)))
    if not head[EXCHANGE]:
        return worst
    worst = max(worst, _call(head[EXIT_INIT], (handle,)))
    worst = max(worst, _update(head, handle))
    return max(worst, _call(head[ENTER_CONT], (handle,)))


@njit(cache=True)
def _has(own, theta):  # type: ignore[no-untyped-def]
    """Was an instance initialised with these parameters?"""
    same = own[READY] == 1.0
    for i in range(theta.size):
        same &= own[THETA + i] == theta[i]
    return same


@njit(cache=True)
def _take(table, head, theta):  # type: ignore[no-untyped-def]
    """Take an instance, one that has these parameters if there is one. Returns the address of its row."""
    words = THETA + head[PARAMETERS]
    first, chosen = table + 8 * HEAD, 0
    for k in range(head[INSTANCES]):
        if _has(carray(_as_doubles(first + 8 * words * k), words), theta):
            chosen = k
            break
    while _swapped(first + 8 * words * chosen, 0, 1) == 0:
        chosen = (chosen + 1) % head[INSTANCES]
    return first + 8 * words * chosen


@njit(cache=True)
def _at(head, row, x, u, theta):  # type: ignore[no-untyped-def]
    """Bring an instance to a state, inputs and parameters. Returns the worst status."""
    words = THETA + theta.size
    own, handle = carray(_as_doubles(row), words), carray(_as_ints(row), words)[HANDLE]
    worst = 0
    if not _has(own, theta):
        own[READY] = 0.0
        worst = _initialise(head, handle, theta)
        for i in range(theta.size):
            own[THETA + i] = theta[i]
        own[READY] = 1.0
    worst = max(worst, _reals(head, SET_REALS, handle, OF_INPUTS, head[INPUTS], u.ctypes.data))
    if not head[EXCHANGE]:
        return max(worst, _reals(head, SET_REALS, handle, OF_STATES, head[STATES], x.ctypes.data))
    worst = max(worst, _call(head[SET_STATES], (handle, x.ctypes.data, head[STATES])))
    if head[EVENTS] > 0:  # relations are frozen between events: they are looked at anew at every state
        worst = max(worst, _call(head[ENTER_EVENT], (handle,)))
        worst = max(worst, _update(head, handle))
        worst = max(worst, _call(head[ENTER_CONT], (handle,)))
    return worst


@njit(cache=True)
def _reads(head, function, references, handle, values):  # type: ignore[no-untyped-def]
    """Get some of its numbers: states and rates by their own functions in model exchange. Returns the status."""
    if head[EXCHANGE] and function != GET_REALS:
        return _call(head[function], (handle, values.ctypes.data, values.size))
    return _reals(head, GET_REALS, handle, references, values.size, values.ctypes.data)


@njit(cache=True)
def _give(row, worst):  # type: ignore[no-untyped-def]
    """Give an instance back; after an error it begins anew."""
    if worst > WORST:
        carray(_as_doubles(row), THETA)[READY] = 0.0
    _swapped(row, 1, 0)


@njit(cache=True, error_model="numpy", inline="always")
def _told(key, x, u, theta, size, function, references):  # type: ignore[no-untyped-def]
    """What an FMU tells at a state: as many numbers as its head has at ``size``; NaN where it reports an error.

    It is written into its callers, so that the places are constants there: a call by them takes a fifth more time.
    """
    table = _table(key)
    head = carray(_as_ints(table), HEAD)
    found = np.empty(head[size])
    row = _take(table, head, theta)
    worst = _at(head, row, x, u, theta)
    handle = carray(_as_ints(row), THETA)[HANDLE]
    worst = max(worst, _reads(head, function, references, handle, found))
    _give(row, worst)
    if worst > WORST:
        found[:] = np.nan
    return found


@njit(cache=True, error_model="numpy")
def rates(key, x, u, theta):  # type: ignore[no-untyped-def]
    """dx/dt (nx,) of an FMU; NaN where it reports an error."""
    return _told(key, x, u, theta, STATES, GET_RATES, OF_RATES)


@njit(cache=True, error_model="numpy")
def readings(key, x, u, theta):  # type: ignore[no-untyped-def]
    """y (ny,) of an FMU; NaN where it reports an error."""
    return _told(key, x, u, theta, OUTPUTS, GET_REALS, OF_OUTPUTS)


@njit(cache=True, error_model="numpy")
def kept(key, x, u, theta):  # type: ignore[no-untyped-def]
    """The states (nx,) that an FMU has once it was brought to x; NaN where it reports an error."""
    return _told(key, x, u, theta, STATES, GET_STATES, OF_STATES)


@njit(cache=True)
def start(key, theta):  # type: ignore[no-untyped-def]
    """The states (nx,) in which an FMU starts with these parameters; NaN where it reports an error."""
    table = _table(key)
    head = carray(_as_ints(table), HEAD)
    x = np.empty(head[STATES])
    row = _take(table, head, theta)
    handle = carray(_as_ints(row), THETA)[HANDLE]
    worst = max(_initialise(head, handle, theta), _reads(head, GET_STATES, OF_STATES, handle, x))
    _give(row, ERROR)  # what begins next with it begins anew
    if worst > WORST:
        x[:] = np.nan
    return x


@njit(cache=True)
def _step(head, handle, now_s, seconds):  # type: ignore[no-untyped-def]
    """Let an FMU for co-simulation go on by so many seconds. Returns the status."""
    told, yes = np.zeros(4, np.int64), np.int32(1)
    if head[VERSION] == 2:
        return _call(head[DO_STEP], (handle, now_s, seconds, yes))
    at = told.ctypes.data
    return _call(head[DO_STEP], (handle, now_s, seconds, yes, at, at + 8, at + 16, at + 24))


@njit(cache=True, error_model="numpy", nogil=True)
def run(key, u, seconds, x0, theta):  # type: ignore[no-untyped-def]
    """Step an FMU through stretches of constant inputs u (S, nu) that last so many seconds (S,), from a start (nx,).

    Returns readings and states (S, ny + nx) at the begin of each; NaN from where it reports an error.
    """
    table = _table(key)
    head = carray(_as_ints(table), HEAD)
    outputs, states, inputs = head[OUTPUTS], head[STATES], head[INPUTS]
    found = np.full((u.shape[0], outputs + states), np.nan)
    row = _take(table, head, theta)
    handle, now_s = carray(_as_ints(row), THETA)[HANDLE], head.view(np.float64)[BEGINS]
    worst = _initialise(head, handle, theta)
    worst = max(worst, _reals(head, SET_REALS, handle, OF_STATES, states, x0.ctypes.data))
    worst = max(worst, _reals(head, SET_REALS, handle, OF_INPUTS, inputs, u[0].ctypes.data))
    worst = max(worst, _call(head[EXIT_INIT], (handle,)))
    for k in range(u.shape[0]):
        worst = max(worst, _reals(head, SET_REALS, handle, OF_INPUTS, inputs, u[k].ctypes.data))
        read = found[k]
        worst = max(worst, _reals(head, GET_REALS, handle, OF_OUTPUTS, outputs, read.ctypes.data))
        worst = max(worst, _reals(head, GET_REALS, handle, OF_STATES, states, read[outputs:].ctypes.data))
        if worst > WORST:
            found[k] = np.nan
            break
        if seconds[k] > 0.0:
            worst = max(worst, _step(head, handle, now_s, seconds[k]))
            now_s += seconds[k]
    _give(row, ERROR)  # what begins next with it begins anew
    return found
