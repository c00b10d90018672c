"""Rewrite the conditions of a function as calls, so that both arms can be followed and joined where they end.

A function that is followed with symbols meets `if` as a question for true or false, which a symbol cannot answer.
The syntax tree shows what depends on the answer: the two arms and the names that they assign. Each `if` becomes
a call of `conditions.follow_arms`, which follows both arms and goes on once:

```text
if x > 0.0:                    def true():
    y = x                          nonlocal y
else:                              y = x
    y = -x           ->        def false():
                                   nonlocal y
                                   y = -x
                               join(x > 0.0, true, false, ("y",))
```

Conditional expressions, `and`, `or`, `not` and chained comparisons become calls whose arms are lambdas. What follows
an arm that ends early belongs to the other arm, so that both arms return:

```text
if c:                          def true():
    return a         ->            return a
return b                       def false():
                                   return b
                               return join(c, true, false, ())
```

`check` and `notes` of a model tell their sentences in place of yielding them, so that their conditions have arms, too.

Left as it is, and thus followed once for each answer, is what cannot be moved into a function: an arm with `yield`,
with `break`, or with a `return` that is not its end.
"""

from __future__ import annotations

import ast
import copy
import inspect
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from types import CodeType, FunctionType, ModuleType
from typing import Any, NamedTuple

#: What a rewritten function calls: names that no model can give.
JOIN, BOTH, EITHER, COMPARE, EQUAL, TELL = "join'", "and'", "or'", "compare'", "equal'", "tell'"
#: The arms of a statement, and what the arms of an expression have as a parameter.
TRUE, FALSE, ARM = "true'", "false'", "arm'"
#: The function that binds these names.
MAKE = "make'"
SCOPES = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda, ast.ClassDef, ast.GeneratorExp)
COMPREHENSIONS = (ast.ListComp, ast.SetComp, ast.DictComp)
#: What has names of its own.
NAME_SCOPES = (*SCOPES, *COMPREHENSIONS)
LOOPS = (ast.For, ast.AsyncFor, ast.While)
#: What no arm can have; a `return` where nothing follows the arm, and a `continue` at its end, are taken out before.
UNMOVABLE = (
    ast.Yield, ast.YieldFrom, ast.Await, ast.Break, ast.Continue, ast.Return, ast.Delete, ast.Import,
    ast.ImportFrom, ast.ClassDef, ast.Try, ast.With, ast.AsyncWith, ast.AsyncFor, ast.NamedExpr,
)  # fmt: skip
Statements = Sequence[ast.stmt]


class RewrittenIf(NamedTuple):
    """What a condition has become, and whether the rest of its block is in it."""

    statements: Statements
    takes_rest: bool


@lru_cache(maxsize=1024)
def rewritten(
    original: FunctionType, helpers: frozenset[tuple[str, Callable[..., Any]]], tells: bool
) -> Any:
    """The function with its conditions as calls of the helpers; itself where its source is not at hand.

    One that `tells` passes each sentence to the helper of this name where the original yields it.
    """
    place = original.__name__, original.__code__.co_firstlineno
    definition = definitions(inspect.getmodule(original)).get(place)
    if definition is None or original.__closure__:
        return original
    definition, values = copy.deepcopy(definition), dict(helpers)
    tells = tells and inspect.isgeneratorfunction(original)
    if tells:
        definition = ast.fix_missing_locations(YieldsToCalls().visit(definition))
    source = compile(factory(definition, list(values)), original.__code__.co_filename, "exec")
    made: dict[str, Any] = {}
    exec(renamed(source, original.__name__), original.__globals__, made)  # noqa: S102
    function: FunctionType = made[MAKE](*values.values())
    function.__defaults__, function.__kwdefaults__ = original.__defaults__, original.__kwdefaults__
    return (lambda *p, **named: function(*p, **named) or ()) if tells else function


@lru_cache(maxsize=64)
def definitions(module: ModuleType | None) -> dict[tuple[str, int], ast.FunctionDef]:
    """The functions of a module that can be rewritten, by name and first line."""
    try:
        tree = ast.parse(inspect.getsource(module)) if module else ast.Module([], [])
    except OSError:
        return {}
    return {
        (node.name, min([node.lineno, *(part.lineno for part in node.decorator_list)])): node
        for node in tree.body
        if isinstance(node, ast.FunctionDef)
        and not any(isinstance(part, ast.Global | ast.Nonlocal) for part in ast.walk(node))
    }


def renamed(code: CodeType, owner: str) -> CodeType:
    """The code with arms named like the function that they are part of, as messages have it."""
    constants = []
    for part in code.co_consts:
        if isinstance(part, CodeType):
            is_arm = part.co_name in (TRUE, FALSE) or ARM in part.co_varnames
            part = renamed(part, owner if is_arm else part.co_name)
        constants.append(part)
    return code.replace(co_name=owner, co_consts=tuple(constants))


def factory(definition: ast.FunctionDef, helpers: list[str]) -> ast.Module:
    """A module with a function that takes the helpers and returns the rewritten function."""
    definition.decorator_list, definition.returns = [], None
    arguments = definition.args
    for argument in ast.walk(definition):
        if isinstance(argument, ast.arg):
            argument.annotation = None
    arguments.defaults = [ast.Constant(None) for _ in arguments.defaults]
    arguments.kw_defaults = [default and ast.Constant(None) for default in arguments.kw_defaults]
    body = [Rewriter().visit(definition), ast.Return(ast.Name(definition.name, ast.Load()))]
    module = ast.Module([function_definition(MAKE, body, helpers)], [])
    return ast.fix_missing_locations(module)


def function_definition(
    name: str, body: list[ast.stmt], parameters: Sequence[str] = ()
) -> ast.FunctionDef:
    """The syntax tree of a function."""
    arguments = ast.arguments([], list(map(ast.arg, parameters)), None, [], [], None, [])
    return ast.FunctionDef(name, arguments, body, [])


def parts_outside(scopes: tuple[type[ast.AST], ...], *nodes: ast.AST) -> Iterator[ast.AST]:
    """The nodes and all within them, but not within nodes of these kinds."""
    for node in nodes:
        yield node
        if not isinstance(node, scopes):
            yield from parts_outside(scopes, *ast.iter_child_nodes(node))


def unmovable_kinds(*nodes: ast.AST) -> set[type[ast.AST]]:
    """The kinds of `UNMOVABLE` nodes within these, without `break` and `continue` of the loops among them."""
    found: set[type[ast.AST]] = set()
    for node in nodes:
        if isinstance(node, ast.If):
            found |= unmovable_kinds(node.test, *node.body, *node.orelse)
            continue
        of_node = {type(x) for x in parts_outside(SCOPES, node) if isinstance(x, UNMOVABLE)}
        if isinstance(node, LOOPS):
            of_node -= {ast.Break, ast.Continue}
            found |= unmovable_kinds(*node.orelse)
        found |= of_node
    return found


def ends(statements: Statements) -> bool:
    """Whether nothing that follows these statements is reached from their end."""
    last = statements[-1] if statements else None
    if isinstance(last, ast.If):
        return ends(last.body) and ends(last.orelse)
    return isinstance(last, ast.Return | ast.Raise | ast.Continue)


def assigned_names(statements: Statements) -> set[str]:
    """The names that these statements assign."""
    names = set()
    for part in parts_outside(NAME_SCOPES, *statements):
        if isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store):
            names.add(part.id)
        elif isinstance(part, ast.FunctionDef | ast.MatchAs | ast.MatchStar) and part.name:
            names.add(part.name)
    return names


class YieldsToCalls(ast.NodeTransformer):
    """Turns a generator of sentences into a function that tells them."""

    def visit_Expr(self, node: ast.Expr) -> ast.stmt:
        """`yield s` as a call, `yield from` as a loop."""
        if isinstance(node.value, ast.Yield) and node.value.value:
            return ast.copy_location(ast.Expr(helper_call(TELL, node.value.value)), node)
        if isinstance(node.value, ast.YieldFrom):
            told = ast.Expr(helper_call(TELL, ast.Name("sentence'", ast.Load())))
            loop = ast.For(ast.Name("sentence'", ast.Store()), node.value.value, [told], [])
            return ast.copy_location(loop, node)
        return node


class Scope:
    """One function that is rewritten: where its names are read, and the names that its arms assign."""

    def __init__(self, definition: ast.FunctionDef) -> None:
        self.reads: set[tuple[str, int, int]] = set()
        self.read_at_any_time: set[str] = set()
        self.of_arms: set[str] = set()
        for part in parts_outside(NAME_SCOPES, *definition.body):
            if isinstance(part, SCOPES):
                self.read_at_any_time |= {n.id for n in ast.walk(part) if isinstance(n, ast.Name)}
            elif isinstance(part, COMPREHENSIONS):
                self.reads |= {name_and_place(n) for n in ast.walk(part) if isinstance(n, ast.Name)}
            elif isinstance(part, ast.AugAssign) and isinstance(part.target, ast.Name):
                self.reads.add(name_and_place(part.target))
            elif isinstance(part, ast.Name) and isinstance(part.ctx, ast.Load):
                self.reads.add(name_and_place(part))

    def read_after(self, node: ast.stmt, loop: ast.stmt | None) -> set[str]:
        """The names that may be read after a statement, which may stand in a loop."""
        end = node.end_lineno or 0, node.end_col_offset or 0
        start = (loop.lineno, loop.col_offset) if loop else end
        later = {name for name, *place in self.reads if tuple(place) >= min(start, end)}
        return later | self.read_at_any_time


def name_and_place(node: ast.Name) -> tuple[str, int, int]:
    """A name, its line and its column."""
    return node.id, node.lineno, node.col_offset


class Rewriter(ast.NodeTransformer):
    """Rewrites functions, the innermost last; `loop` is the outermost loop around a statement."""

    def __init__(self) -> None:
        self.scope: Scope | None = None
        self.loop: ast.stmt | None = None

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        """Rewrite a function; what its arms assign is bound in it."""
        outer = self.scope, self.loop
        self.scope, self.loop = Scope(node), None
        node.body = self.rewritten_block(node.body, ast.Return)
        if self.scope.of_arms:
            targets: list[ast.expr] = [
                ast.Name(name, ast.Store()) for name in sorted(self.scope.of_arms)
            ]
            never = ast.If(ast.Constant(False), [ast.Assign(targets, ast.Constant(None))], [])
            node.body.insert(0, never)
        self.scope, self.loop = outer
        return node

    def rewritten_block(
        self, statements: Statements, before_only: type[ast.stmt] | None
    ) -> list[ast.stmt]:
        """Statements rewritten; nothing but `before_only` follows them, where it is given."""
        done: list[ast.stmt] = []
        for index, statement in enumerate(statements):
            rest = statements[index + 1 :]
            if isinstance(statement, ast.If):
                made = self.rewritten_if(statement, rest, before_only)
                done += made.statements
                if made.takes_rest:
                    break
                continue
            if isinstance(statement, LOOPS):
                self.rewrite_loop(statement)
            elif isinstance(statement, ast.Match):
                statement.subject = self.visit(statement.subject)
                for case in statement.cases:
                    case.body = self.rewritten_block(case.body, None if rest else before_only)
            elif isinstance(statement, ast.With):
                statement.body = self.rewritten_block(statement.body, None)
            else:
                statement = self.visit(statement)
            done.append(statement)
        return done

    def rewrite_loop(self, loop: ast.For | ast.AsyncFor | ast.While) -> None:
        """Rewrite head and body of a loop in their place."""
        if isinstance(loop, ast.While):
            loop.test = self.visit(loop.test)
        else:
            loop.iter = self.visit(loop.iter)
        outer, self.loop = self.loop, self.loop or loop
        loop.body = self.rewritten_block(loop.body, ast.Continue)
        self.loop = outer
        loop.orelse = self.rewritten_block(loop.orelse, None)

    def rewritten_if(
        self, node: ast.If, rest: Statements, before_only: type[ast.stmt] | None
    ) -> RewrittenIf:
        """A condition rewritten, with the rest of its block where one of its arms ends before that."""
        assert self.scope is not None
        arms: list[list[ast.stmt]] = [node.body, node.orelse]
        fixed = unmovable_kinds(*node.body, *node.orelse)
        takes_rest = before_only is not None and before_only in fixed and any(map(ends, arms))
        if takes_rest:
            arms = [arm if ends(arm) else [*arm, *rest] for arm in arms]
            fixed = unmovable_kinds(*arms[0], *arms[1]) - {before_only}
        test, names = node.test, assigned_names([*arms[0], *arms[1]])
        if isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not):
            test, arms = test.operand, arms[::-1]
        bodies: list[list[ast.stmt]] = []
        if not fixed and not assigns_to_part(arms):
            copies = (copy.deepcopy(without_last_continue(arm)) for arm in arms)
            within = before_only if takes_rest else None
            bodies = [self.rewritten_block(arm, within) for arm in copies]
        if not bodies or any(ast.Continue in unmovable_kinds(*body) for body in bodies):
            within = None if rest else before_only
            node.test = self.visit(node.test)
            node.body = self.rewritten_block(node.body, within)
            node.orelse = self.rewritten_block(node.orelse, within)
            return RewrittenIf([node], False)
        self.scope.of_arms |= names
        returns = takes_rest and before_only is ast.Return
        live = set() if returns else names & self.scope.read_after(node, self.loop)
        first: list[ast.stmt] = [ast.Nonlocal(sorted(names))] if names else []
        functions = [
            function_definition(name, [*first, *body] or [ast.Pass()])
            for name, body in zip((TRUE, FALSE), bodies)
        ]
        live_names = ast.Tuple([ast.Constant(name) for name in sorted(live)], ast.Load())
        references = (ast.Name(name, ast.Load()) for name in (TRUE, FALSE))
        call = helper_call(JOIN, self.visit(test), *references, live_names)
        made = [*functions, ast.Return(call) if returns else ast.Expr(call)]
        statements = [ast.copy_location(statement, node) for statement in made]
        return RewrittenIf(statements, takes_rest)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.stmt:
        """An assignment without its annotation, which a name that is not of its own function cannot have."""
        value = node.value and self.visit(node.value)
        if value is None:
            return ast.copy_location(ast.Pass(), node)
        return ast.copy_location(ast.Assign([node.target], value), node)

    def visit_IfExp(self, node: ast.IfExp) -> ast.expr:
        """A conditional expression as a join of two lambdas."""
        self.generic_visit(node)
        if is_movable(node.body) and is_movable(node.orelse):
            arms = arm_lambda(node.body), arm_lambda(node.orelse)
            return helper_call(JOIN, node.test, *arms, at=node)
        return node

    def visit_BoolOp(self, node: ast.BoolOp) -> ast.expr:
        """`a and b and c` as `and'(a, lambda: and'(b, lambda: c))`."""
        self.generic_visit(node)
        if not all(map(is_movable, node.values[1:])):
            return node
        name = BOTH if isinstance(node.op, ast.And) else EITHER
        *values, whole = node.values
        for value in reversed(values):
            whole = helper_call(name, value, arm_lambda(whole), at=node)
        return whole

    def visit_UnaryOp(self, node: ast.UnaryOp) -> ast.expr:
        """`not a` as a join of False and True."""
        self.generic_visit(node)
        if not isinstance(node.op, ast.Not):
            return node
        arms = [arm_lambda(ast.Constant(answer)) for answer in (False, True)]
        return helper_call(JOIN, node.operand, *arms, at=node)

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        """`a < b < c` as a call, which evaluates each operand once; `a == b` as one that compares item by item."""
        self.generic_visit(node)
        if len(node.ops) == 1 and isinstance(node.ops[0], ast.Eq | ast.NotEq):
            relation = comparison_lambda(node.ops[0])
            return helper_call(EQUAL, node.left, node.comparators[0], relation, at=node)
        if len(node.ops) == 1 or not all(map(is_movable, node.comparators)):
            return node
        pairs = zip(node.ops, node.comparators)
        steps = [f for op, right in pairs for f in (comparison_lambda(op), arm_lambda(right))]
        return helper_call(COMPARE, node.left, *steps, at=node)


def comparison_lambda(op: ast.cmpop) -> ast.Lambda:
    """A comparison as a function of its two operands."""
    a, b = (ast.Name(name, ast.Load()) for name in ("a'", "b'"))
    return ast.Lambda(function_definition("", [], ("a'", "b'")).args, ast.Compare(a, [op], [b]))


def arm_lambda(value: ast.expr) -> ast.Lambda:
    """An expression as an arm, which is evaluated when that is called."""
    arguments = function_definition("", []).args
    arguments.vararg = ast.arg(ARM)
    return ast.Lambda(arguments, value)


def helper_call(name: str, *arguments: ast.expr, at: ast.expr | None = None) -> ast.Call:
    """A call of a helper, in the place of an expression."""
    call = ast.Call(ast.Name(name, ast.Load()), list(arguments), [])
    return ast.copy_location(call, at) if at else call


def is_movable(node: ast.expr) -> bool:
    """Whether an expression can become a function."""
    return not any(isinstance(part, UNMOVABLE) for part in ast.walk(node))


def assigns_to_part(arms: Sequence[Statements]) -> bool:
    """Whether an arm assigns to an attribute or an item of something."""
    within = (part for arm in arms for statement in arm for part in ast.walk(statement))
    return any(
        isinstance(part, ast.Attribute | ast.Subscript) and not isinstance(part.ctx, ast.Load)
        for part in within
    )


def without_last_continue(arm: Statements) -> Statements:
    """An arm without a `continue` at its end."""
    return arm[:-1] if arm and isinstance(arm[-1], ast.Continue) else arm
