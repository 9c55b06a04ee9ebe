"""Damage to gonio, in memory: a fragment of a function is replaced, and what is compiled with it is compiled anew."""

import __future__

import functools
import importlib
import inspect
import pkgutil
import textwrap
from typing import NamedTuple

import numba

import gonio.transport


class Damage(NamedTuple):
    """What is broken, and the law that must see it."""

    name: str
    place: str
    """module.function or module.Class.method of gonio."""
    fragment: str
    """What is replaced; it occurs once in that function."""
    replacement: str
    law: object

    def inflict(self, monkeypatch):
        """Damage gonio until the monkeypatch is undone."""
        module = max((name for name in MODULES if f"gonio.{self.place}".startswith(f"{name}.")), key=len)
        *owners, name = f"gonio.{self.place}".removeprefix(f"{module}.").split(".")
        owner = functools.reduce(getattr, owners, MODULES[module])
        original = inspect.getattr_static(owner, name)
        if isinstance(original, property):
            monkeypatch.setattr(owner, name, property(self._damaged(original.fget)))
        elif isinstance(original, classmethod):
            monkeypatch.setattr(owner, name, classmethod(self._damaged(original.__func__)))
        elif owners:
            monkeypatch.setattr(owner, name, self._damaged(original))
        elif hasattr(original, "py_func"):
            callers = {kernel: compiled(kernel.py_func) for kernel in compiled_with(original)}
            replace_everywhere(monkeypatch, {**callers, original: compiled(self._damaged(original.py_func))})
        else:
            replace_everywhere(monkeypatch, {original: self._damaged(original)})

    def _damaged(self, function):
        source = textwrap.dedent(inspect.getsource(function))
        assert source.count(self.fragment) == 1, f"{self.place} has changed: {self.fragment!r} is not in it once"
        undecorated = source[source.index("def ") :].replace(self.fragment, self.replacement)
        code = compile(undecorated, f"<{self.name}>", "exec", flags=__future__.annotations.compiler_flag)
        defined = {}
        exec(code, function.__globals__, defined)
        return defined[function.__name__]


compiled = numba.njit(nogil=True, error_model="numpy")
"""As gonio's kernels are, but never to be found in a cache; globals are looked up at the first call."""

MODULES = {
    name: importlib.import_module(name)
    for package in (gonio, gonio.transport)
    for name in (f"{package.__name__}.{found.name}" for found in pkgutil.iter_modules(package.__path__))
}
"""The modules of gonio, and those of its transport, by their names."""


def compiled_with(kernel):
    """The kernels that call `kernel`, directly or through another, wherever they are."""
    kernels = {k for module in MODULES.values() for k in vars(module).values() if hasattr(k, "py_func")}
    callers, found = set(), {kernel}
    while found:
        found = {
            caller
            for caller in kernels - callers
            if any(caller.py_func.__globals__.get(name) in found for name in caller.py_func.__code__.co_names)
        }
        callers |= found
    return callers


def replace_everywhere(monkeypatch, replacements):
    """Put others in the place of functions, in every module that has imported them."""
    for module in MODULES.values():
        for name, value in list(vars(module).items()):
            if inspect.isroutine(value) or hasattr(value, "py_func"):
                monkeypatch.setattr(module, name, replacements.get(value, value))
