"""No regular expression of the package takes time that grows with the square of its text.

The automaton of an expression tells it without a clock: a text can be tried in a number of ways
that grows with its length if and only if a word leads from a state p to p and to another state q,
and from q to q. `search` tries every start, which is a state of its own.
"""

import ast
from functools import cache
from importlib import import_module
from itertools import permutations
from pathlib import Path
import re

try:
    from re import _constants as op  # from Python 3.11
    from re import _parser as parser
except ImportError:
    import sre_constants as op
    import sre_parse as parser

import pytest

PACKAGE = Path(__file__).parents[1] / "evpinn_ros"
METHODS = {"match", "fullmatch", "search", "sub", "subn", "split", "findall", "finditer"}
CATEGORIES = {op.CATEGORY_DIGIT: r"\d", op.CATEGORY_SPACE: r"\s", op.CATEGORY_WORD: r"\w"}
CATEGORIES |= {op.CATEGORY_NOT_DIGIT: r"\D", op.CATEGORY_NOT_SPACE: r"\S"}
CATEGORIES |= {op.CATEGORY_NOT_WORD: r"\W"}
ANY = (op.ANY, None)
UNBOUNDED = 64  # repeats above; fewer are a factor


class Automaton:
    """States and their successors: a state is a place in the expression that takes a character."""

    def __init__(self, pattern, flags, searched, whole):
        tree = parser.parse(pattern, flags)
        self.ignore_case = tree.state.flags & re.IGNORECASE
        self.labels, self.after = [ANY], [set()]  # state 0: before the match
        items = list(tree)
        behind = None
        if items and items[0][0] is op.ASSERT_NOT and items[0][1][0] < 0:
            behind = items.pop(0)[1][1]
        begins = items and items[0] in ((op.AT, op.AT_BEGINNING), (op.AT, op.AT_BEGINNING_STRING))
        first, last, empty = self.sequence(items)
        if searched and not (begins and not tree.state.flags & re.MULTILINE):
            self.after[0].add(0)
            start = 0
            if begins or (behind and len(behind) == 1):  # what stands before a match is limited
                label = (op.LITERAL, 10) if begins else (op.ASSERT_NOT, behind[0])
                start = self.state(label)
                self.after[0].add(start)
            self.after[start] |= first
        anchored = whole or (items and items[-1][0] in (op.AT, op.ASSERT, op.ASSERT_NOT))
        self.accepting = set() if anchored else last
        self.always = empty and not anchored
        self.letters = self.alphabet()
        takes = [{char for char in self.letters if self.takes(x, char)} for x in self.labels]
        self.steps = [
            {char: {s for s in after if char in takes[s]} for char in self.letters}
            for after in self.after
        ]

    def state(self, label):
        self.labels.append(label)
        self.after.append(set())
        return len(self.labels) - 1

    def sequence(self, items):
        """First and last states of items in a row, and whether they take the empty text."""
        first, last, empty = set(), set(), True
        for item in items:
            begins, ends, skipped = self.item(*item)
            for state in last:
                self.after[state] |= begins
            first |= begins if empty else set()
            last = ends | (last if skipped else set())
            empty = empty and skipped
        return first, last, empty

    def item(self, kind, value):
        if kind in (op.LITERAL, op.NOT_LITERAL, op.ANY, op.IN):
            state = self.state((kind, value))
            return {state}, {state}, False
        if kind in (op.AT, op.ASSERT, op.ASSERT_NOT, op.GROUPREF):
            return set(), set(), True
        if kind is op.SUBPATTERN:
            return self.sequence(value[-1])
        if kind is op.BRANCH:
            parts = [self.sequence(part) for part in value[1]]
            firsts, lasts, empties = zip(*parts, strict=True)
            return set().union(*firsts), set().union(*lasts), any(empties)
        assert kind in (op.MAX_REPEAT, op.MIN_REPEAT), kind
        least, most, body = value
        loops = most > UNBOUNDED
        # Inner repeats twice: else the two ways of (a*)* would be one.
        first, last, empty = self.sequence([*body, *body] if loops and repeats(body) else body)
        for state in last if loops else ():
            self.after[state] |= first
        return first, last, empty or not least

    def alphabet(self):
        """A character for each set of states that take the same."""
        candidates = {*range(0x180), *numbers(self.labels)}
        classes = {
            tuple(self.takes(label, chr(code)) for label in self.labels): chr(code)
            for code in sorted(candidates)
            if code < 0x110000
        }
        return [*classes.values()]

    def takes(self, label, char):
        kind, value = label
        both = {char, char.lower(), char.upper()} if self.ignore_case else {char}
        if kind is op.LITERAL:
            return chr(value) in both
        if kind is op.NOT_LITERAL:
            return chr(value) not in both
        if kind is op.ANY:
            return label is ANY or char != "\n"
        if kind is op.RANGE:
            return any(chr(value[0]) <= variant <= chr(value[1]) for variant in both)
        if kind is op.CATEGORY:
            return re.fullmatch(CATEGORIES[value], char) is not None
        if kind is op.ASSERT_NOT:
            return not self.takes(value, char)
        assert kind is op.IN, kind
        negated = value[0][0] is op.NEGATE
        return any(self.takes(option, char) for option in value[negated:]) != negated

    def reached(self, begins):
        seen, new = set(begins), list(begins)
        while new:
            new = [s for state in new for s in self.after[state] if s not in seen]
            seen |= set(new)
        return seen

    def square(self):
        """A pair of states between which a text can be divided anywhere; None without one."""
        behind = [self.reached(after) for after in self.after]
        loops = [state for state, after in enumerate(behind) if state in after]
        for p, q in permutations(loops, 2):
            if q in behind[p] and q not in self.accepting and not self.always:
                seen, new = set(), [(p, p, q)]
                while new:
                    a, b, c = new.pop()
                    for char in self.letters:
                        for d in self.steps[a][char]:
                            for e in self.steps[b][char]:
                                for f in self.steps[c][char]:
                                    if (d, e, f) == (p, q, q):
                                        return p, q
                                    there = p in behind[d] and q in behind[e] and q in behind[f]
                                    if there and (d, e, f) not in seen:
                                        seen.add((d, e, f))
                                        new.append((d, e, f))
        return None


def repeats(body):
    return "MAX_REPEAT" in (text := str(body)) or "MIN_REPEAT" in text


def numbers(tree):
    """All character codes in a tree, and their neighbours."""
    if isinstance(tree, int):
        yield from (max(tree - 1, 0), int(tree), int(tree) + 1)
    elif isinstance(tree, (list, tuple)):
        for part in tree:
            yield from numbers(part)


def square(pattern, method, flags=0):
    searched, whole = method not in ("match", "fullmatch"), method == "fullmatch"
    return Automaton(pattern, flags, searched, whole).square()


@pytest.mark.parametrize(
    ("pattern", "method", "is_square"),
    [
        (r"[+-]?\d*[.,]\d*[1-9]\d*", "fullmatch", True),  # was in logs/cars.py
        (r"[+-]?\d*[.,]\d*[1-9]0*", "fullmatch", False),
        (r"\d+x", "search", True),
        (r"\d+x", "match", False),
        (r"\d+", "search", False),
        (r"(?<!\d)\d+x", "search", False),
        (r"(a*)*b", "match", True),
        (r"(ab*c)*d", "match", False),
        (r"(a|ab)(c|bcd)*x", "match", False),
        (r"\s*,\s*", "split", True),
        (r"a.*b.*c", "match", True),
        (r"^\s+x", "search", False),
    ],
)
def test_the_automaton_knows_squares(pattern, method, is_square):
    assert bool(square(pattern, method)) == is_square


CUT = {("logs/clock_start.py", "STARTED")}  # its text is cut to 200 characters
BY_OTHERS = {"_NUMBERS": {"match"}}  # by PyYAML
UNREAD = {"of_message", "'/'.join(parts)"}  # made of texts that were taken apart or escaped


@cache
def expressions():
    """File, name or text, expression, flags and method of every use of `re` in the package."""
    trees = {path: ast.parse(path.read_text()) for path in sorted(PACKAGE.rglob("*.py"))}
    used = {}  # methods by the name of a compiled expression
    for tree in trees.values():
        for node in ast.walk(tree):
            if isinstance(node, ast.Attribute) and node.attr in METHODS:
                name = getattr(node.value, "id", getattr(node.value, "attr", ""))
                used.setdefault(name, set()).add(node.attr)
    uses = []
    for path, tree in trees.items():
        assigned = {
            call: ast.unparse(node.targets[0])
            for node in ast.walk(tree)
            if isinstance(node, ast.Assign)
            for call in ast.walk(node.value)
        }
        file = str(path.relative_to(PACKAGE))
        for call in (node for node in ast.walk(tree) if isinstance(node, ast.Call)):
            function = ast.unparse(call.func).rpartition("re.")[2]
            if ast.unparse(call.func) != f"re.{function}" or function == "escape":
                continue
            text = ast.unparse(call.args[0])
            if text in UNREAD:
                continue
            module = import_module(f"evpinn_ros.{file[:-3].replace('/', '.')}")
            pattern = eval(text, vars(module))
            flags = [ast.unparse(word) for word in call.args[1:]]
            flags = eval(next((flag for flag in flags if flag.startswith("re.")), "0"), {"re": re})
            name = assigned.get(call, "")
            methods = (
                {function}
                if function != "compile"
                else BY_OTHERS.get(name) or used.get(name, {"search"})
            )
            uses += [(file, name or text, pattern, flags, method) for method in methods]
    return uses


def test_no_expression_takes_the_square_of_its_text():
    assert len(expressions()) > 50
    squares = {
        (file, name) for file, name, *use in expressions() if square(use[0], use[2], use[1])
    }
    assert squares == CUT
