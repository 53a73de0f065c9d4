"""Mutants of a source file: what a slip of the keyboard or of thought could have written in its place."""

from __future__ import annotations

import ast
import copy
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import CodeType

__all__ = ["Mutant", "code_of", "mutants_of"]

_OPERATORS = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.FloorDiv: ast.Div, ast.Mod: ast.Mult,
    ast.Pow: ast.Mult, ast.BitAnd: ast.BitOr, ast.BitOr: ast.BitAnd,
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
}  # fmt: skip
_TURNED = {ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Gt: ast.Lt, ast.GtE: ast.LtE}
_PAIRS = (
    ("sin", "cos"), ("min", "max"), ("amin", "amax"), ("argmin", "argmax"), ("minimum", "maximum"), ("mean", "sum"),
    ("nanmean", "nansum"), ("floor", "ceil"), ("any", "all"), ("clamp_min", "clamp_max"), ("zeros", "ones"),
    ("zeros_like", "ones_like"), ("exp", "log"), ("sqrt", "square"),
)  # fmt: skip
_OTHER_NAMES = {one: other for pair in _PAIRS for one, other in (pair, pair[::-1])}
_DROPPED = {
    "T", "mT", "abs", "sqrt", "square", "clamp", "clamp_min", "clamp_max", "nan_to_num", "detach", "exp", "log", "clip",
    "cumsum", "round", "floor", "ceil", "copy", "clone", "masked_fill", "where", "astype", "transpose", "cpu",
}  # fmt: skip
"""Attributes and methods without which the value is of the same kind."""
_GUARD = 1e-3
"""Constants below it are guards against division by 0: their exact value is nobody's business."""
_SKIPPED = (ast.Raise, ast.Assert, ast.JoinedStr, ast.Import, ast.ImportFrom, ast.Delete)


@dataclass
class Mutant:
    """One change of one place of a file."""

    path: str
    function: str
    """Qualified name; for a constant of the module its name."""
    kind: str
    """``body`` of a function, a ``default`` of its arguments, or a ``constant`` of the module."""
    line: int
    statement_line: int
    change: str
    place: int = 0
    """Of the default among the arguments, keyword-only ones after the others."""
    code: CodeType | None = None
    """Of the module (``body``), or of the new value's expression."""


@dataclass
class _Site:
    """A node, and where it hangs."""

    node: ast.AST
    parent: ast.AST
    field: str
    index: int | None
    statement: ast.stmt

    def put(self, node: ast.AST | None) -> None:
        if self.index is None:
            setattr(self.parent, self.field, node)
        else:
            getattr(self.parent, self.field)[self.index] = node


def mutants_of(path: Path, root: Path) -> Iterator[Mutant]:
    """Yield every mutant of a file, in the order of its lines."""
    tree, seen = ast.parse(path.read_text()), Counter[tuple[str, str]]()
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            node.decorator_list = []  # they are not run again
    where = str(path.relative_to(root))
    for statement in tree.body:
        for mutant in _of_statement(statement, "", where, tree, path):
            seen[mutant.function, mutant.change] += 1
            count = seen[mutant.function, mutant.change]
            mutant.change += f" #{count}" if count > 1 else ""
            yield mutant


def _of_statement(statement: ast.stmt, outer: str, where: str, tree: ast.Module, path: Path) -> Iterator[Mutant]:
    if isinstance(statement, ast.ClassDef):
        for inner in statement.body:
            if isinstance(inner, (ast.FunctionDef, ast.ClassDef)):
                yield from _of_statement(inner, f"{outer}{statement.name}.", where, tree, path)
    elif isinstance(statement, ast.FunctionDef):
        name = outer + statement.name
        defaults = [*statement.args.defaults, *statement.args.kw_defaults]
        for place, default in enumerate(defaults):
            for new, change in _changes(_site(default, statement)) if default else ():
                code = _expression(new, path)
                yield Mutant(where, name, "default", statement.lineno, statement.body[0].lineno, change, place, code)
        for site in _sites(statement):
            for new, change in _changes(site):
                site.put(new)
                code = _compiled(tree, path)
                site.put(site.node)
                if code:
                    line = getattr(site.node, "lineno", site.statement.lineno)
                    yield Mutant(where, name, "body", line, site.statement.lineno, change, 0, code)
    elif isinstance(statement, ast.Assign) and isinstance(statement.targets[0], ast.Name):
        name = statement.targets[0].id
        if not name.startswith("__") and isinstance(statement.value, (ast.Constant, ast.UnaryOp, ast.Tuple)):
            yield from _of_constant(statement, name, where, path)


def _of_constant(statement: ast.Assign, name: str, where: str, path: Path) -> Iterator[Mutant]:
    for site in [_site(statement.value, statement), *_inside(statement.value, statement)]:
        for new, change in _changes(site):
            if site.node is statement.value:
                yield Mutant(
                    where, name, "constant", statement.lineno, statement.lineno, change, 0, _expression(new, path)
                )
            else:
                site.put(new)
                code = _expression(statement.value, path)
                site.put(site.node)
                yield Mutant(where, name, "constant", statement.lineno, statement.lineno, change, 0, code)


def _expression(node: ast.AST, path: Path) -> CodeType:
    return compile(ast.fix_missing_locations(ast.Expression(copy.deepcopy(node))), str(path), "eval")


def _compiled(tree: ast.Module, path: Path) -> CodeType | None:
    try:
        return compile(ast.fix_missing_locations(tree), str(path), "exec", dont_inherit=True)
    except (SyntaxError, ValueError):
        return None


def _site(node: ast.AST, statement: ast.stmt) -> _Site:
    return _Site(node, statement, "", None, statement)


def _sites(function: ast.FunctionDef) -> Iterator[_Site]:
    """Yield every node of a function's body that may be changed; what is inside messages and annotations may not."""
    for index, statement in enumerate(function.body):
        if not (isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)):
            yield from _walk(_Site(statement, function, "body", index, statement))


def _inside(node: ast.AST, statement: ast.stmt) -> Iterator[_Site]:
    for field, value in ast.iter_fields(node):
        if field in ("annotation", "returns", "decorator_list", "type_comment", "ctx"):
            continue
        for index, child in enumerate(value) if isinstance(value, list) else [(None, value)]:
            if isinstance(child, ast.AST):
                yield from _walk(_Site(child, node, field, index, child if isinstance(child, ast.stmt) else statement))


def _walk(site: _Site) -> Iterator[_Site]:
    if isinstance(site.node, _SKIPPED):
        return
    yield site
    yield from _inside(site.node, site.statement)


def _changes(site: _Site) -> Iterator[tuple[ast.AST, str]]:
    """Yield what may stand in a node's place, and what that changes."""
    node = site.node
    for new in _new_nodes(node, site):
        old, now = ast.unparse(node), ast.unparse(new)
        if isinstance(node, (ast.If, ast.While)):
            old, now = ast.unparse(node.test), ast.unparse(new.test)  # type: ignore[attr-defined]
        if old != now:
            around = "" if site.node is site.statement else f"  in  {_headline(site.statement)}"
            yield ast.copy_location(new, node), f"{old[:80]}  ->  {now[:80]}{around}"


def _headline(statement: ast.stmt) -> str:
    return ast.unparse(statement).partition("\n")[0][:100]


def _new_nodes(node: ast.AST, site: _Site) -> Iterator[ast.AST]:
    if isinstance(node, ast.Constant):
        yield from _new_constants(node, site)
    elif isinstance(node, ast.BinOp):
        yield from _new_operations(node)
    elif isinstance(node, ast.UnaryOp):
        yield node.operand
    elif isinstance(node, ast.Compare) and len(node.ops) == 1:
        for table in (_OPERATORS, _TURNED):
            if type(node.ops[0]) in table:
                yield ast.Compare(node.left, [table[type(node.ops[0])]()], node.comparators)
    elif isinstance(node, ast.Compare):
        for place, op in enumerate(node.ops):
            ops = [_OPERATORS[type(op)]() if i == place else other for i, other in enumerate(node.ops)]
            yield ast.Compare(node.left, ops, node.comparators)
    elif isinstance(node, ast.BoolOp):
        yield ast.BoolOp(_OPERATORS[type(node.op)](), node.values)
    elif isinstance(node, (ast.If, ast.While)):
        turned = copy.copy(node)
        turned.test = ast.UnaryOp(ast.Not(), node.test)
        yield turned
    elif isinstance(node, ast.IfExp):
        yield ast.IfExp(node.test, node.orelse, node.body)
    elif isinstance(node, ast.Call):
        yield from _new_calls(node)
    elif isinstance(node, ast.Attribute) and node.attr in ("T", "mT"):
        yield node.value
    elif isinstance(node, ast.Slice) and (node.lower or node.upper):
        yield ast.Slice(None, node.upper, node.step) if node.lower else ast.Slice(node.lower, None, node.step)
    elif isinstance(node, ast.stmt):
        yield from _new_statements(node)


def _new_constants(node: ast.Constant, site: _Site) -> Iterator[ast.AST]:
    value = node.value
    if isinstance(value, bool):
        yield ast.Constant(not value)
    elif isinstance(value, int):
        yield ast.Constant(value + 1)
        if value > 0:
            yield ast.Constant(value - 1)
    elif isinstance(value, float) and abs(value) >= _GUARD:
        yield ast.Constant(value * 1.5)
        yield ast.Constant(-value)
    elif value == 0 and isinstance(value, float):
        yield ast.Constant(1.0)


def _new_operations(node: ast.BinOp) -> Iterator[ast.AST]:
    if isinstance(node.op, ast.MatMult):
        yield ast.BinOp(node.right, node.op, node.left)
    elif type(node.op) in _OPERATORS:
        yield ast.BinOp(node.left, _OPERATORS[type(node.op)](), node.right)
        if isinstance(node.op, (ast.Add, ast.Sub, ast.Mult)):
            yield node.left


def _new_calls(node: ast.Call) -> Iterator[ast.AST]:
    starred = any(isinstance(one, ast.Starred) for one in node.args)
    if len(node.args) >= 2 and not starred:
        yield ast.Call(node.func, [node.args[1], node.args[0], *node.args[2:]], node.keywords)
    for place, keyword in enumerate(node.keywords):
        if keyword.arg and keyword.arg not in ("device", "dtype"):
            yield ast.Call(node.func, node.args, [k for i, k in enumerate(node.keywords) if i != place])
    function = node.func
    if isinstance(function, ast.Attribute):
        if function.attr in _OTHER_NAMES:
            renamed = ast.Attribute(function.value, _OTHER_NAMES[function.attr], ast.Load())
            yield ast.Call(renamed, node.args, node.keywords)
        module = isinstance(function.value, ast.Name) and function.value.id in ("np", "torch", "math")
        if function.attr in _DROPPED:
            if not module:
                yield function.value
            elif node.args:
                yield node.args[0]
    elif isinstance(function, ast.Name):
        if function.id in ("min", "max", "any", "all"):
            yield ast.Call(ast.Name(_OTHER_NAMES[function.id], ast.Load()), node.args, node.keywords)
        elif function.id in ("abs", "sorted", "reversed", "round") and node.args:
            yield node.args[0]


def _new_statements(node: ast.stmt) -> Iterator[ast.AST]:
    if isinstance(node, ast.AugAssign):
        if type(node.op) in _OPERATORS:
            yield ast.AugAssign(node.target, _OPERATORS[type(node.op)](), node.value)
        yield ast.Pass()
    elif isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
        yield ast.Pass()
    elif isinstance(node, ast.Assign) and len(node.targets) == 1:
        target = node.targets[0]
        names = {one.id for one in ast.walk(node.value) if isinstance(one, ast.Name)}
        if (isinstance(target, ast.Name) and target.id in names) or isinstance(target, ast.Subscript):
            yield ast.Pass()
    elif isinstance(node, (ast.Continue, ast.Break)):
        yield ast.Pass()


def code_of(module: CodeType, qualified: str) -> CodeType | None:
    """Return the code of a function or method of a compiled module."""
    for constant in module.co_consts:
        if isinstance(constant, CodeType):
            if constant.co_qualname == qualified:
                return constant
            if qualified.startswith(f"{constant.co_qualname}."):
                return code_of(constant, qualified)
    return None
