"""Functions of Python as JavaScript, with all that they use: what a page of equations tells is
written once, and a browser tells the same.

`report/live/python.js` has the operators, and by the same names what is used of Python, numpy, scipy
and cosim. Functions and classes of the page, and of the packages named here, are translated.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import math
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, fields, is_dataclass
from functools import cached_property, partial
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

from cosim import SetupError

TRANSLATED = ("workbench", "cosim.figures", "cosim.judge.certify")
GIVEN = ("Bench", "Table", "parameters", "harmonics")
BINARY = {
    ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.Div: "div", ast.FloorDiv: "floordiv",
    ast.Mod: "mod", ast.Pow: "pow", ast.BitOr: "or", ast.BitAnd: "and", ast.MatMult: "matmul",
}  # fmt: skip
GROWN = {ast.Add: "extended", ast.BitOr: "updated"}
COMPARED = {
    ast.Eq: "eq", ast.NotEq: "ne", ast.Lt: "lt", ast.LtE: "le", ast.Gt: "gt", ast.GtE: "ge",
    ast.In: "has", ast.NotIn: "hasnot", ast.Is: "same", ast.IsNot: "differs",
}  # fmt: skip
UNARY = {ast.USub: "py.neg", ast.Invert: "py.invert", ast.Not: "!py.truth", ast.UAdd: ""}
RESERVED = {
    "new", "function", "var", "let", "const", "case", "this", "default", "switch", "delete", "void",
    "typeof", "instanceof", "throw", "catch", "export", "super", "enum", "do", "eval", "arguments",
}  # fmt: skip
SCOPED = (ast.FunctionDef, ast.Lambda, ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)


def script(roots: Mapping[str, Any], packages: Iterable[str]) -> str:
    """JavaScript whose `page` holds the roots by name, of functions, classes and values.

    Raises SetupError with file and line for what cannot be translated.
    """
    made = _Script((*packages, *TRANSLATED))
    page = ", ".join(f"{name}: {made.value(root)}" for name, root in roots.items())
    words = [*made.classes, *made.functions, *made.constants, f"const page = {{ {page} }};"]
    return "\n".join(words)


class _Script:
    """What was translated so far: classes, functions, and values that stand on them, in this order."""

    def __init__(self, packages: Sequence[str]) -> None:
        self._packages = packages
        self._names: dict[int, str] = {}
        self._kept: list[Any] = []
        self.classes: list[str] = []
        self.functions: list[str] = []
        self.constants: list[str] = []

    def value(self, it: Any, hint: str = "it") -> str:
        """An expression for a value of Python."""
        if isinstance(it, (str, bool)) or it is None:
            return _text(it)
        if isinstance(it, (int, float)):
            finite = "NaN" if math.isnan(it) else "Infinity" if it > 0 else "-Infinity"
            return repr(it) if math.isfinite(it) else finite
        if id(it) in self._names:
            return self._names[id(it)]
        if isinstance(it, complex):
            return f"new py.Complex({self.value(it.real)}, {self.value(it.imag)})"
        if isinstance(it, (FunctionType, type)) and self._own(it):
            return self._translated(it)
        if hasattr(it, "cache_info") and self._own(it.__wrapped__):
            return self._constant(it, it.__name__)
        if inspect.ismethod(it):
            return f"{self.value(it.__self__)}.{it.__name__}"
        if callable(it) and not isinstance(it, partial):
            return _native(it)
        if isinstance(it, tuple) and hasattr(it, "_fields"):
            return f"new {self.value(type(it))}({', '.join(map(self.value, it))})"
        if is_dataclass(it):
            held = (self.value(getattr(it, x.name)) for x in fields(it))
            return f"new {self.value(type(it))}({', '.join(held)})"
        if isinstance(it, (list, tuple, set, frozenset, Mapping, np.ndarray, partial)):
            return self._constant(it, hint)
        raise SetupError(f"LIVE cannot use {it!r:.80}")

    def _own(self, it: Any) -> bool:
        inside = (f"{it.__module__}.".startswith(f"{name}.") for name in self._packages)
        return it.__name__ not in GIVEN and any(inside)

    def _named(self, it: Any, name: str) -> str:
        self._names[id(it)] = name
        self._kept.append(it)
        return name

    def _constant(self, it: Any, hint: str) -> str:
        if hasattr(it, "cache_info"):
            text = f"lib.cache({self.value(it.__wrapped__)})"
        elif isinstance(it, partial):
            words = ", ".join(f"{key}: {self.value(x)}" for key, x in it.keywords.items())
            text = (
                f"lib.partial.made({self.value(it.func)}, {self.value(list(it.args))}, {{{words}}})"
            )
        elif isinstance(it, Mapping):
            pairs = (f"[{self.value(key)}, {self.value(x)}]" for key, x in it.items())
            text = f"new py.Dict([{', '.join(pairs)}])"
        else:
            text = f"[{', '.join(map(self.value, it if not isinstance(it, np.ndarray) else it.tolist()))}]"
            text = f"np.array({text})" if isinstance(it, np.ndarray) else text
            text = f"new Set({text})" if isinstance(it, (set, frozenset)) else text
        name = f"{hint}${len(self._kept)}"
        self.constants.append(f"const {name} = {text};")
        return self._named(it, name)

    def _translated(self, it: Any) -> str:
        name = self._named(it, f"{it.__name__.strip('<>')}${len(self._kept)}")
        if isinstance(it, type):
            self.classes.append(self._class(it, name))
        else:
            self.functions.append(_Function(self, it).declared(name))
        return name

    def _class(self, it: Any, name: str) -> str:
        """A NamedTuple or dataclass: its fields, and its methods and those above it; an exception."""
        kind: type = it
        if issubclass(kind, Exception):
            return f"class {name} extends Raised {{}}"
        if hasattr(it, "_fields"):
            base, known, above = "py.Tuple", list(it._fields), [it]
            given = {key: self.value(x) for key, x in it._field_defaults.items()}
        elif is_dataclass(it):
            base, known = "py.Record", [x.name for x in fields(it)]
            above = list(type.mro(kind))
            given = {x.name: self.value(x.default) for x in fields(it) if x.default is not MISSING}
            empty = {x.name: x.default_factory for x in fields(it)}
            given |= {
                key: f"py.call({self.value(x)}, [])" for key, x in empty.items() if x is not MISSING
            }
        else:
            raise SetupError(f"LIVE cannot use the class {it.__name__}")
        parameters = [f"{_safe(x)} = {given[x]}" if x in given else _safe(x) for x in known]
        body = [f"static fields = {_text(known)};"]
        body.append(f"constructor({', '.join(parameters)}) {{ super(); "
                    + " ".join(f"this.{x} = {_safe(x)};" for x in known) + " }")  # fmt: skip
        members: dict[str, Any] = {}
        for kind in reversed(above):
            if self._own(kind):
                members |= {key: x for key, x in vars(kind).items() if not key.startswith("__")}
        more = []
        for key, member in members.items():
            if isinstance(member, (property, cached_property)):
                got: Any = member.fget if isinstance(member, property) else member.func
                told = _Function(self, got).method()
                kept = f"() {{ return py.kept(this, '{key}', function{told}); }}"
                body.append(f"get {key}{told if isinstance(member, property) else kept}")
            elif isinstance(member, (FunctionType, classmethod, staticmethod)):
                function: Any = getattr(member, "__func__", member)
                if function.__globals__.get("__name__") != "collections":
                    static = "" if isinstance(member, FunctionType) else "static "
                    made = _Function(self, function)
                    body.append(f"{static}{made.star}{key}{made.method()}")
                    owner = f"{name}{'' if static else '.prototype'}"
                    more.append(f"{owner}.{key}.params = {made.params(1)};")
        return "\n".join([f"class {name} extends {base} {{", *body, "}", *more])


class _Function:
    """A function of Python, and the names that are its own at a place."""

    def __init__(self, made: _Script, function: FunctionType) -> None:
        self._made, self._of = made, inspect.unwrap(function)
        lines, first = inspect.getsourcelines(self._of)
        try:
            tree = ast.parse(textwrap.dedent("".join(lines)))
        except SyntaxError:
            raise SetupError(f"LIVE cannot use the lambda in {self._of.__module__}") from None
        ast.increment_lineno(tree, first - 1)
        self._node: Any = next(
            x for x in ast.walk(tree) if isinstance(x, (ast.FunctionDef, ast.Lambda))
        )
        self._scopes: list[set[str]] = []
        self.star = "*" if _yields(self._node) else ""

    def declared(self, name: str) -> str:
        """The whole function under a name."""
        return f"{self._function(self._node, name)}\n{name}.params = {self.params(0)};"

    def method(self) -> str:
        """Parameters but the first, and the body, of a method."""
        node = self._node
        self._scopes.append(_locals(node))
        own = _safe(node.args.args[0].arg)
        text = f"{self._parameters(node, 1)} {{ const {own} = this;\n{self._body(node)} }}"
        self._scopes.pop()
        return text

    def params(self, skip: int) -> str:
        return _text(_names(self._node)[skip:])

    def _refuse(self, node: ast.AST, what: str) -> SetupError:
        line = getattr(node, "lineno", self._node.lineno)
        return SetupError(f"{self._of.__code__.co_filename}:{line}: LIVE cannot use {what}")

    def _function(self, node: Any, name: str) -> str:
        self._scopes.append(_locals(node))
        head = self._parameters(node, 0)
        if isinstance(node, ast.Lambda):
            text = f"const {name} = ({head} => {self._see(node.body)});"
        else:
            star = "*" if _yields(node) else ""
            text = f"function{star} {name}{head} {{\n{self._body(node)} }}"
        self._scopes.pop()
        return text

    def _parameters(self, node: Any, skip: int) -> str:
        a = node.args
        if a.kwarg or (a.vararg and a.kwonlyargs):
            raise self._refuse(node, "a function with such parameters")
        plain = [*a.posonlyargs, *a.args]
        defaults = [None] * (len(plain) - len(a.defaults)) + a.defaults
        each = [*zip(plain, defaults), *zip(a.kwonlyargs, a.kw_defaults)][skip:]
        words = [
            _safe(x.arg) + (f" = {self._see(default)}" if default else "") for x, default in each
        ]
        return f"({', '.join(words + ([f'...{_safe(a.vararg.arg)}'] if a.vararg else []))})"

    def _body(self, node: Any) -> str:
        inner = {x.name for x in ast.walk(node) if isinstance(x, ast.FunctionDef) and x is not node}
        own = sorted(map(_safe, _locals(node) - set(_names(node)) - inner))
        own = [x for x in own if x not in {_safe(y) for y in _names(node, True)}]
        return "\n".join([f"let {', '.join(own)};"] * bool(own) + self._statements(node.body))

    def _statements(self, body: Sequence[ast.stmt]) -> list[str]:
        return [text for node in body if (text := self._do(node))]

    def _block(self, body: Sequence[ast.stmt]) -> str:
        return "{ " + "\n".join(self._statements(body)) + " }"

    def _do(self, node: Any) -> str:
        see = self._see
        match node:
            case ast.Expr(value=ast.Constant()) | ast.Pass() | ast.Assert():
                return ""
            case ast.Expr(value):
                return f"{see(value)};"
            case ast.Return(value):
                return f"return {see(value) if value else 'null'};"
            case ast.Assign(targets, value):
                first, *more = targets
                text = self._assigned(first, see(value))
                return text + "".join(self._assigned(x, see(first)) for x in more)
            case ast.AnnAssign(target, _, value):
                return self._assigned(target, see(value)) if value else ""
            case ast.AugAssign(target, op, value):
                new = f"py.{GROWN.get(type(op)) or BINARY[type(op)]}({see(target)}, {see(value)})"
                return self._assigned(target, new)
            case ast.If(test, body, orelse):
                rest = f" else {self._block(orelse)}" if orelse else ""
                return f"if (py.truth({see(test)})) {self._block(body)}{rest}"
            case ast.While(test, body, []):
                return f"while (py.truth({see(test)})) {self._block(body)}"
            case ast.For(target, among, body, orelse):
                loop = f"for ({self._target(target)} of py.iter({see(among)})) {self._block(body)}"
                return f"whole: {{ {loop}\n{self._block(orelse)} }}" if orelse else loop
            case ast.Break():
                return "break whole;" if self._within_else(node) else "break;"
            case ast.Continue():
                return "continue;"
            case ast.Raise(exc) if exc is not None:
                return f"throw {see(exc)};"
            case ast.FunctionDef(name=name):
                return f"{self._function(node, _safe(name))}\n{_safe(name)}.params = {_text(_names(node))};"
            case ast.ImportFrom(names=names):
                return " ".join(f"{_safe(x.asname or x.name)} = lib.{x.name};" for x in names)
            case ast.Try(body, handlers, [], []):
                text = "throw error$;"
                for x in reversed(handlers):
                    own = f"{_safe(x.name)} = error$; " if x.name else ""
                    text = (f"if (py.caught(error$, {see(x.type)})) {{ {own}{self._block(x.body)} }} "
                            f"else {{ {text} }}")  # fmt: skip
                return f"try {self._block(body)} catch (error$) {{ {text} }}"
        raise self._refuse(node, f"{type(node).__name__} here")

    def _within_else(self, node: ast.Break) -> bool:
        """Whether a break leaves a loop that has an else."""
        loops = [x for x in ast.walk(self._node) if isinstance(x, (ast.For, ast.While))]
        around = [x for x in loops if node in ast.walk(x)]
        return bool(around[-1].orelse)

    def _assigned(self, target: Any, value: str) -> str:
        if isinstance(target, ast.Subscript):
            return f"py.store({self._see(target.value)}, {self._index(target.slice)}, {value});"
        if isinstance(target, ast.Name):
            return f"{_safe(target.id)} = {value};"
        if isinstance(target, (ast.Tuple, ast.List)):
            if any(isinstance(x, ast.Subscript) for x in target.elts):
                texts = (self._assigned(x, f"held$[{k}]") for k, x in enumerate(target.elts))
                return f"{{ const held$ = [...py.iter({value})]; {' '.join(texts)} }}"
            starred = [k for k, x in enumerate(target.elts) if isinstance(x, ast.Starred)]
            if starred and starred[0] < len(target.elts) - 1:
                value = f"py.unpacked({value}, {starred[0]}, {len(target.elts) - 1 - starred[0]})"
                each = [x.value if isinstance(x, ast.Starred) else x for x in target.elts]
                return f"{self._target(ast.Tuple(each))} = {value};"
            return f"{self._target(target)} = py.iter({value});"
        raise self._refuse(target, "this assignment")

    def _target(self, node: Any) -> str:
        match node:
            case ast.Name(name):
                return _safe(name)
            case ast.Tuple(each) | ast.List(each):
                bare = (isinstance(x, ast.Name) and x.id == "_" for x in each)
                return f"[{', '.join('' if unseen else self._target(x) for x, unseen in zip(each, bare))}]"
            case ast.Starred(value):
                return f"...{self._target(value)}"
            case ast.Subscript() | ast.Attribute():
                raise self._refuse(node, "this target")
        raise self._refuse(node, type(node).__name__)

    def _see(self, node: Any) -> str:
        see = self._see
        match node:
            case ast.Constant(value):
                return "undefined" if value is ... else self._made.value(value)
            case ast.Name(name):
                return self._name(node, name)
            case ast.Attribute(value, name):
                static = self._static(node)
                if static is not self:
                    return self._made.value(static[0], name)
                if name in ("real", "imag", "T", "shape", "size", "__name__"):
                    return f"py.attribute({see(value)}, {name!r})"
                return f"{see(value)}.{name}"
            case ast.BinOp(left, op, right):
                return f"py.{BINARY[type(op)]}({see(left)}, {see(right)})"
            case ast.UnaryOp(ast.USub(), ast.Constant(int() | float() as value)):
                return f"-{value!r}"
            case ast.UnaryOp(op, operand):
                return f"{UNARY[type(op)]}({see(operand)})"
            case ast.BoolOp(op, values):
                word = "both" if isinstance(op, ast.And) else "either"
                text = see(values[-1])
                for value in reversed(values[:-1]):
                    text = f"py.{word}({see(value)}, () => {text})"
                return text
            case ast.Compare(left, ops, others):
                pairs = zip([left, *others], ops, others)
                each = [f"py.{COMPARED[type(op)]}({see(a)}, {see(b)})" for a, op, b in pairs]
                text = each.pop()
                for first in reversed(each):
                    text = f"py.both({first}, () => {text})"
                return text
            case ast.IfExp(test, body, orelse):
                return f"(py.truth({see(test)}) ? {see(body)} : {see(orelse)})"
            case ast.NamedExpr(target, value):
                return f"({_safe(target.id)} = {see(value)})"
            case ast.List(each) | ast.Tuple(each):
                return f"[{self._several(each)}]"
            case ast.Set(each):
                return f"new Set([{self._several(each)}])"
            case ast.Dict(keys, values):
                return f"new py.Dict([{', '.join(self._pair(k, x) for k, x in zip(keys, values))}])"
            case ast.Subscript(value, index):
                return f"py.item({see(value)}, {self._index(index)})"
            case ast.JoinedStr(values):
                return f"py.text({', '.join(map(self._part, values))})"
            case ast.Call():
                return self._call(node)
            case ast.Lambda():
                self._scopes.append(_locals(node))
                text = f"py.lambda({self._parameters(node, 0)} => {see(node.body)}, {_text(_names(node))})"
                self._scopes.pop()
                return text
            case ast.ListComp() | ast.SetComp() | ast.DictComp() | ast.GeneratorExp():
                return self._comprehension(node)
            case ast.Yield(value):
                return f"(yield {see(value)})"
            case ast.YieldFrom(value):
                return f"(yield* py.iter({see(value)}))"
        raise self._refuse(node, type(node).__name__)

    def _pair(self, key: Any, value: Any) -> str:
        if key is None:
            return f"...py.pairs({self._see(value)})"
        return f"[{self._see(key)}, {self._see(value)}]"

    def _several(self, each: Sequence[Any]) -> str:
        return ", ".join(
            f"...py.iter({self._see(x.value)})" if isinstance(x, ast.Starred) else self._see(x)
            for x in each
        )

    def _part(self, node: Any) -> str:
        if isinstance(node, ast.Constant):
            return _text(node.value)
        form = self._see(node.format_spec) if node.format_spec else '""'
        value = self._see(node.value)
        return f"py.format({f'py.repr({value})' if node.conversion == 114 else value}, {form})"

    def _index(self, node: Any) -> str:
        if isinstance(node, ast.Slice):
            ends = (self._see(x) if x else "null" for x in (node.lower, node.upper, node.step))
            return f"new py.Slice({', '.join(ends)})"
        if isinstance(node, ast.Tuple):
            return f"new py.Key([{', '.join(map(self._index, node.elts))}])"
        return self._see(node)

    def _comprehension(self, node: Any) -> str:
        before, after = "", ""
        depth = len(self._scopes)
        for one in node.generators:
            among = self._see(one.iter)
            self._scopes.append({x.id for x in ast.walk(one.target) if isinstance(x, ast.Name)})
            before += f"for (const {self._target(one.target)} of py.iter({among})) {{ "
            before += "".join(f"if (py.truth({self._see(test)})) " for test in one.ifs) + "{ "
            after += " } }"
        if isinstance(node, ast.DictComp):
            item = f"[{self._see(node.key)}, {self._see(node.value)}]"
        else:
            item = self._see(node.elt)
        del self._scopes[depth:]
        if isinstance(node, ast.GeneratorExp):
            return f"(function*() {{ {before}yield {item};{after} }}).call(this)"
        kinds = {
            ast.ListComp: "out$",
            ast.SetComp: "new Set(out$)",
            ast.DictComp: "new py.Dict(out$)",
        }
        made = kinds[type(node)]
        return f"(() => {{ const out$ = []; {before}out$.push({item});{after} return {made}; }})()"

    def _call(self, node: ast.Call) -> str:
        if any(isinstance(x, ast.Starred) for x in node.args):
            args = f"[{self._several(node.args)}]"
        else:
            args = f"[{', '.join(map(self._see, node.args))}]"
        named = [f"...{self._see(x.value)}.plain()" if x.arg is None else f"{x.arg}: {self._see(x.value)}"
                 for x in node.keywords]  # fmt: skip
        words = f", {{{', '.join(named)}}}" if named else ""
        function: Any = node.func
        if isinstance(function, ast.Subscript) and _kind(function.value):
            function = function.value
        if isinstance(function, ast.Attribute) and self._static(function) is self:
            return f"py.method({self._see(function.value)}, {function.attr!r}, {args}{words})"
        return f"py.call({self._see(function)}, {args}{words})"

    def _name(self, node: ast.AST, name: str) -> str:
        if any(name in scope for scope in self._scopes):
            return _safe(name)
        closed = inspect.getclosurevars(self._of).nonlocals
        for names in (closed, self._of.__globals__, vars(builtins)):
            if name in names:
                return self._made.value(names[name], name)
        raise self._refuse(node, f"the name {name!r}")

    def _static(self, node: ast.Attribute) -> Any:
        """What stands in a module or a class of the project, alone in a tuple; else `self`."""
        inner: Any = node.value
        holder: Any = None
        if isinstance(inner, ast.Name) and not any(inner.id in scope for scope in self._scopes):
            holder = self._of.__globals__.get(inner.id)
        elif isinstance(inner, ast.Attribute) and (found := self._static(inner)) is not self:
            (holder,) = found
        if isinstance(holder, ModuleType):
            return (getattr(holder, node.attr),)
        return self


def _locals(node: Any) -> set[str]:
    """Names that a function assigns, and its parameters."""
    found = set(_names(node, True))
    pending = list(ast.iter_child_nodes(node))
    while pending:
        one = pending.pop()
        if isinstance(one, ast.FunctionDef):
            found.add(one.name)
        elif isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store):
            found.add(one.id)
        elif isinstance(one, ast.ImportFrom):
            found |= {x.asname or x.name for x in one.names}
        elif isinstance(one, ast.ExceptHandler) and one.name:
            found.add(one.name)
        if isinstance(one, (ast.ListComp, ast.SetComp, ast.DictComp, ast.GeneratorExp)):
            found |= {x.target.id for x in ast.walk(one) if isinstance(x, ast.NamedExpr)}
            pending += [x.iter for x in one.generators[:1]]
        elif not isinstance(one, (ast.FunctionDef, ast.Lambda)):
            pending += ast.iter_child_nodes(one)
    return found


def _names(node: Any, rest: bool = False) -> list[str]:
    """Parameters, and with `rest` the one that takes all others."""
    a = node.args
    each = [*a.posonlyargs, *a.args, *a.kwonlyargs, *([a.vararg] if rest and a.vararg else [])]
    return [x.arg for x in each]


def _yields(node: Any) -> bool:
    """Whether a function is a generator."""
    pending = list(ast.iter_child_nodes(node))
    while pending:
        one = pending.pop()
        if isinstance(one, (ast.Yield, ast.YieldFrom)):
            return True
        if not isinstance(one, SCOPED):
            pending += ast.iter_child_nodes(one)
    return False


def _kind(node: Any) -> bool:
    """Whether this names a class of Python, as list does in list[float]()."""
    return isinstance(node, ast.Name) and isinstance(vars(builtins).get(node.id), type)


def _native(it: Any) -> str:
    """What the runtime has under the same name: functions of numpy and math, and all others."""
    module = (getattr(it, "__module__", "") or "").partition(".")[0]
    name = getattr(it, "__name__", str(it))
    if isinstance(it, np.ufunc) or module == "numpy":
        return f"np.{name}"
    return f"math.{name}" if module == "math" else f"lib.{name}"


def _safe(name: str) -> str:
    return f"{name}$" if name in RESERVED else name


def _text(value: Any) -> str:
    import json

    return json.dumps(value)
