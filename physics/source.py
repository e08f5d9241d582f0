"""The equations of a composed simulator, written out as Python source.

A term that is off costs a comparison. Those at one kind of port with as many parameters stand together: they share
a vector of the simulator's parameters and their own, and nothing is made ready for them while all are off.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from twinbench.physics.simulator import Simulator, Term

_HELPERS = '''
def some(theta, at, absent):
    """Is any of these sizes not at its absent value?"""
    for k in range(at.size):
        if theta[at[k]] != absent[k]:
            return True
    return False


def behind(base, whole):
    """``whole`` with ``base`` at its beginning; a mechanism's own entries come behind it."""
    for i in range(base.size):
        whole[i] = base[i]
    return whole
'''


class Part(NamedTuple):
    """Where one mechanism acts, and where its own states and parameters stand in the whole vectors.

    ``into`` is the second balance that it acts on, or -1.
    """

    number: int
    mechanism: Term
    at: int
    state: int
    parameter: int
    into: int

    @property
    def on(self) -> str:
        """Its first parameter is not at the value that switches it off."""
        return f"theta[{self.parameter}] != {self.mechanism.off!r}"

    def acts_on(self, place: str) -> bool:
        """Is its port at such a place?"""
        return self.mechanism.port.place == place


def write(simulator: Simulator, parts: Sequence[Part], n_states: int) -> tuple[str, dict[str, Callable[..., Any]]]:
    """Source of ``rhs`` and ``output``, and of ``flux`` and ``balance`` if the simulator has them.

    Args:
        n_states: of the simulator and all mechanisms.

    Returns:
        The text, which needs NumPy as ``np``, and the functions that it calls, by name.
    """
    n, m = len(simulator.states), len(simulator.parameters)
    groups = {kind: _groups(parts, kind) for kind in ("input", "flux", "balance", "output")}
    added = {kind: _added(kind, group, n, m) for kind, group in groups.items()}
    rates = (
        # Number by number: numba takes a second to compile each assignment of a slice.
        f"    dx = np.empty({n_states})\n    for i in range({n}):\n        dx[i] = d[i]\n"
        f"    for i in range({n}, {n_states}):\n        dx[i] = 0.0\n{added['balance']}    return dx\n"
    )

    def equation(signature: str, acting: str, base: str, rest: str) -> str:
        """A function with the terms at some kinds of ports; the call of the simulator's own where all are off."""
        on = [name for kind in acting.split() for name in groups[kind]]
        checks = "".join(f"    {name} = some(theta, {name}_at, {name}_absent)\n" for name in on)
        short = f"    if not ({' or '.join(on)}):\n        return np.asarray({base})\n"
        if n_states > n and "balance" in acting:
            short = ""
        elif not on:
            short, rest = f"    return np.asarray({base})\n", ""
        start = f"    b, p, v = x[:{n}], theta[:{m}], u\n"
        return f"\n\ndef {signature}:\n{start}{checks}{short}{added['input']}{rest}"

    names: dict[str, Callable[..., Any] | None] = {"base_output": simulator.output}
    base = "base_output(b, v, p)"
    rest = f"    y_own = np.asarray({base})\n    y = y_own\n{added['output']}    return y\n"
    equations = [equation("output(x, u, theta)", "input output", base, rest)]
    if simulator.flux is None:
        names["base_rhs"] = simulator.rhs
        base = "base_rhs(b, v, p)"
        equations.append(equation("rhs(x, u, theta)", "input balance", base, f"    d = {base}\n{rates}"))
    else:
        names |= {"base_flux": simulator.flux, "base_balance": simulator.balance}
        flux, balance = "base_flux(b, v, p)", "base_balance(b, v, p, f)"
        flows = f"    f_own = np.asarray({flux})\n    f = f_own\n{added['flux']}"
        settled = f"    d = {balance}\n{rates}"
        whole = f"base_balance(b, v, p, {flux})"
        equations.append(equation("rhs(x, u, theta)", "input flux balance", whole, flows + settled))
        equations.append(equation("flux(x, u, theta)", "input flux", flux, f"{flows}    return f\n"))
        equations.append(equation("balance(x, u, theta, f)", "input balance", balance, settled))
    for part in parts:
        names[f"term_{part.number}"] = part.mechanism.term
        names[f"derivative_{part.number}"] = part.mechanism.derivative
        names[f"ratio_{part.number}"] = part.mechanism.ratio
    tables = [
        f"{name}_at = np.array({[p.parameter for p in group]})\n"
        f"{name}_absent = np.array({[p.mechanism.off for p in group]})\n"
        for group_of in groups.values()
        for name, group in group_of.items()
    ]
    return "".join((*tables, _HELPERS, *equations)), {name: f for name, f in names.items() if f is not None}


def _groups(parts: Sequence[Part], kind: str) -> dict[str, list[Part]]:
    """Those that act at a kind of port, by how many parameters they have; own states' rates go with the balances."""
    found: dict[str, list[Part]] = {}
    for part in parts:
        if part.acts_on(kind) or (kind == "balance" and part.mechanism.states):
            found.setdefault(f"{kind}_{len(part.mechanism.parameters)}", []).append(part)
    return found


def _added(kind: str, groups: dict[str, list[Part]], n: int, m: int) -> str:
    """The lines that add the terms of a kind to what they act on."""
    to, u = {"input": ("v", "u"), "flux": ("f", "v"), "balance": ("dx", "v"), "output": ("y", "v")}[kind]
    by_itself = {"input": "u", "flux": "f_own", "balance": "d", "output": "y_own"}[kind]
    lines = []
    for name, group in groups.items():
        lines.append(f"    if {name}:")
        if kind != "balance":  # what the simulator's function returned may be one of its arguments
            lines.append(f"        {to} = {to}.copy()")
        lines.append(f"        q = behind(p, np.empty({m + len(group[0].mechanism.parameters)}))")
        for part in group:
            own, k = part.mechanism, part.number
            lines.append(f"        if {part.on}:")
            lines += [f"            q[{m + j}] = theta[{part.parameter + j}]" for j in range(len(own.parameters))]
            x = "s" if own.states else "b"
            if own.states:
                lines.append(f"            s = behind(b, np.empty({n + len(own.states)}))")
                lines += [f"            s[{n + j}] = x[{part.state + j}]" for j in range(len(own.states))]
            if part.acts_on(kind):
                arguments = f"{x}, {u}, q"
                seen = f", {by_itself}[{part.at}]" if own.sees_own else ""
                lines.append(f"            w_{k} = term_{k}({arguments}{seen})")
                lines.append(f"            {to}[{part.at}] += w_{k}")
                if part.into >= 0:
                    lines.append(f"            dx[{part.into}] -= w_{k} * ratio_{k}({arguments})")
            if kind == "balance" and own.states:
                lines.append(f"            r_{k} = derivative_{k}(s, {u}, q)")
                lines += [f"            dx[{part.state + j}] = r_{k}[{j}]" for j in range(len(own.states))]
    return "".join(f"{line}\n" for line in lines)
