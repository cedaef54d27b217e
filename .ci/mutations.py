"""Small errors that can be made in the source of a module, and where to find each again."""

from __future__ import annotations

import ast
import random
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

# What stands for each comparison: its contrary, so that every test of the line can notice.
CONTRARY: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE,
    ast.GtE: ast.Lt,
    ast.Gt: ast.LtE,
    ast.LtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
OPPOSITE: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
}
KINDS = ("comparison", "constant", "dropped", "junction", "raise", "sign")


@dataclass(frozen=True, order=True)
class Place:
    """What names a mutant, however the lines around it move."""

    file: str
    function: str
    # The line of the changed expression or statement, or all its lines in one.
    line: str
    kind: str
    # Which of those of this kind with the same line in the function.
    index: int


@dataclass(frozen=True)
class Mutant:
    """A place in the source as it is now, and what stands there instead."""

    place: Place
    # The lines to which a test must have come: of the expression, or else of its statement.
    numbers: tuple[int, int]
    start: int
    stop: int
    text: str

    def applied(self, source: bytes) -> bytes:
        """Return the source with this error; the rest of the file stays as it is."""
        return source[: self.start] + self.text.encode() + source[self.stop :]


def mutants(file: str, source: bytes) -> list[Mutant]:
    """Return every error that can be made in the functions of a module, in their order."""
    lines = source.splitlines(keepends=True)
    begins = [0]
    for line in lines:
        begins.append(begins[-1] + len(line))
    counts: Counter[tuple[str, ...]] = Counter()
    found = []
    for function, statement, node, kind, text in _changes(ast.parse(source)):
        line = " ".join(each.decode().strip() for each in lines[node.lineno - 1 : node.end_lineno])
        key = (function, line, kind)
        place = Place(file, *key, counts[key])
        counts[key] += 1
        start = begins[node.lineno - 1] + node.col_offset
        stop = begins[node.end_lineno - 1] + node.end_col_offset
        found.append(Mutant(place, (node.lineno, statement.lineno), start, stop, text))
    return found


def _changes(tree: ast.Module) -> Iterator[tuple[str, ast.stmt, ast.AST, str, str]]:
    """Yield the function, the statement, the node, the kind and the new text of each error."""

    def visit(
        node: ast.AST, names: tuple[str, ...], statement: ast.stmt | None
    ) -> Iterator[tuple[str, ast.stmt, ast.AST, str, str]]:
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            inner = (*names, node.name)
            # What runs when the module is imported is run by every test, and by none: it is
            # left alone, as are defaults and decorators.
            inside = statement if isinstance(node, ast.ClassDef) else node
            for child in node.body:
                yield from visit(child, inner, inside)
            return
        if isinstance(node, ast.JoinedStr):  # before Python 3.12 no place in it is known
            return
        if isinstance(node, ast.stmt) and statement is not None:
            statement = node
        if statement is not None:
            for kind, text in _instead(node):
                yield ".".join(names), statement, node, kind, text
        for name, value in ast.iter_fields(node):
            if name in ("annotation", "format_spec"):
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from visit(child, names, statement)

    yield from visit(tree, (), None)


def _instead(node: ast.AST) -> Iterator[tuple[str, str]]:
    """Yield the kind and the text of each error that can be made of a node alone."""
    match node:
        case ast.Compare(left, ops, comparators):
            for at, each in enumerate(ops):
                changed = [*ops[:at], CONTRARY[type(each)](), *ops[at + 1 :]]
                yield "comparison", _expression(ast.Compare(left, changed, comparators))
        # Text and paths would fail wherever they come.
        case ast.BinOp(left, op, right) if type(op) in OPPOSITE and not _texts(left, right):
            yield "sign", _expression(ast.BinOp(left, OPPOSITE[type(op)](), right))
        case ast.UnaryOp(ast.USub(), operand):
            yield "sign", _expression(operand)
        case ast.Constant(float(value)) if value:
            yield "constant", _expression(ast.Constant(1.1 * value))
        # A tenth more of a whole number is none, and would fail wherever one is needed.
        case ast.Constant(int(value)) if not isinstance(value, bool):
            yield "constant", _expression(ast.Constant(value + 1))
        case ast.BoolOp(op, values):
            other = ast.Or() if isinstance(op, ast.And) else ast.And()
            yield "junction", _expression(ast.BoolOp(other, values))
        case ast.Raise():
            yield "raise", "pass"
        case ast.Expr(ast.Call()) | ast.AugAssign() | ast.Continue() | ast.Break():
            yield "dropped", "pass"
        case ast.Assign([ast.Attribute() | ast.Subscript()]):
            yield "dropped", "pass"


def _texts(*nodes: ast.expr) -> bool:
    """Whether one of the nodes is a text."""
    return any(
        isinstance(node, ast.JoinedStr)
        or (isinstance(node, ast.Constant) and isinstance(node.value, str))
        for node in nodes
    )


def _expression(node: ast.expr) -> str:
    """Return the source of an expression that may stand anywhere."""
    return f"({ast.unparse(ast.fix_missing_locations(node))})"


def drawn(
    found: Sequence[Mutant], covered: Callable[[Mutant], bool], number: int, seed: str
) -> list[Mutant]:
    """Return mutants drawn from those that tests cover: kinds in turn, one a line."""
    source = random.Random(seed)
    queues = {kind: [each for each in found if each.place.kind == kind] for kind in KINDS}
    for queue in queues.values():
        queue.sort(key=lambda each: each.place)
        source.shuffle(queue)
    chosen: list[Mutant] = []
    lines: set[tuple[str, int]] = set()
    while len(chosen) < number and any(queues.values()):
        for queue in queues.values():
            while queue and len(chosen) < number:
                each = queue.pop()
                line = (each.place.file, each.numbers[0])
                if line not in lines and covered(each):
                    lines.add(line)
                    chosen.append(each)
                    break
    return sorted(chosen, key=lambda each: each.place)


def matched(places: Iterable[Place], found: Iterable[Mutant]) -> dict[Place, Mutant | None]:
    """Return where each place is now: in its function, one of that name, or with that line."""
    by: dict[tuple, list[Mutant]] = {}
    for each in sorted(found, key=lambda each: each.place):
        place = each.place
        tail = (place.line, place.kind)
        for key in (
            (place.file, place.function, *tail),
            (place.function.rsplit(".", 1)[-1], *tail),
            tail,
        ):
            by.setdefault(key, []).append(each)
    result: dict[Place, Mutant | None] = {}
    for place in places:
        tail = (place.line, place.kind)
        name = place.function.rsplit(".", 1)[-1]
        keys = [(place.file, place.function, *tail), (name, *tail), tail]
        now = next((by[key] for key in keys if key in by), [])
        # Where fewer of the same are left, the last is.
        result[place] = now[min(place.index, len(now) - 1)] if now else None
    return result


def chosen_tests(
    covering: Iterable[str], seconds: Mapping[str, float], most: int, budget: float
) -> list[str]:
    """Return the fastest tests within a number and a time, and at least one within the time."""
    known = sorted((seconds[test], test) for test in covering if test in seconds)
    result, spent = [], 0.0
    for needed, test in known[:most]:
        spent += needed
        if spent > budget:
            break
        result.append(test)
    return result
