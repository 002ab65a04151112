"""Cases: facts under which a rule has to fire, and facts under which it has to stay quiet."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path as FilePath
from typing import Any

from pydantic import Field

from expert.facts import Fact, FieldInfo, Severity, Vocabulary
from expert.firing import Engine, Firing, ResolvedAction
from expert.rules.layers import Merged
from expert.rules.load import LoadedRules
from expert.rules.margin import Judge
from expert.rules.model import Action, Model, Rule, Scalar
from expert.rules.problem import Problem, RuleFileError, suggest
from expert.rules.reader import Document, read_document
from expert.rules.shape import Layer, validate


class GivenFinding(Model):
    """A finding that an earlier rule has derived."""

    finding: str
    severity: Severity = "minor"


class Expected(Model):
    """What a firing has to do: one action, named as in the rule, with the values it must come to."""

    choose: str | None = None
    repair: str | None = None
    exclude: str | None = None
    derive: str | None = None
    assess: str | None = None
    measure: str | None = None
    set: str | None = None
    adjust: str | None = None
    parameter: str | None = None
    severity: Severity | None = None
    to: Scalar | None = None
    with_: dict[str, Scalar] = Field(default_factory=dict, alias="with")


class Case(Model):
    """One case of a rule."""

    name: str = Field(min_length=3)
    facts: list[dict[str, Scalar]] = Field(default_factory=list)
    findings: list[str | GivenFinding] = Field(default_factory=list)
    fires: bool
    expect: Expected | None = None


@dataclass(frozen=True)
class CaseResult:
    """How one case went.

    Attributes
    ----------
    rule, case : str
    file : str
    line : int
    passed, fired, boundary : bool
        `boundary` says that a compared value is exactly at its limit.
    message : str
        Expected, got and the deciding condition; empty when it passed.
    """

    rule: str
    case: str
    file: str
    line: int
    passed: bool
    fired: bool
    boundary: bool
    message: str = ""

    def __str__(self) -> str:
        """Write it as one line."""
        verdict = "passed" if self.passed else "FAILED"
        return f"{self.file}:{self.line}: {verdict}: {self.rule}, {self.case}" + (
            f": {self.message}" if self.message else ""
        )


@dataclass(frozen=True)
class CaseFile:
    """The cases of one rule, each with its line."""

    rule: str
    file: str
    cases: tuple[tuple[Case, int], ...] = field(default=())


def case_directory() -> FilePath:
    """Return the directory of the shipped cases."""
    return FilePath(str(resources.files("knowledge"))) / "cases"


def _facts_problems(layer: Layer, case: Case, index: int, vocabulary: Vocabulary) -> None:
    for number, given in enumerate(case.facts):
        path = (index, "facts", number)
        template = vocabulary.get(str(given.get("fact", "")))
        if template is None:
            message = f"case '{case.name}': there is no fact '{given.get('fact', '')}'"
            layer.complain((*path, "fact"), "unknown-fact", message, suggest(str(given.get("fact", "")), vocabulary))
            continue
        for name, value in given.items():
            info = template.fields.get(name)
            if name == "fact":
                continue
            if info is None:
                message = f"case '{case.name}': fact '{template.name}' has no field '{name}'"
                layer.complain((*path, name), "unknown-field", message, suggest(name, template.fields), key=True)
                continue
            problem = _value_problem(info, value)
            if problem:
                layer.complain((*path, name), problem[0], f"case '{case.name}': {problem[1]}", "correct the value")


def _value_problem(info: FieldInfo, value: Scalar) -> tuple[str, str] | None:
    """Return code and sentence for a value that a field cannot have."""
    text = isinstance(value, str)
    number = isinstance(value, int | float) and not isinstance(value, bool)
    fits = {"boolean": isinstance(value, bool), "text": text}.get(info.kind, number)
    if not fits:
        return "wrong-type", f"'{info.name}' is {value!r}, but must be a {info.kind}"
    if info.choices and value not in info.choices:
        return "out-of-range", f"'{info.name}' is {value!r}, but must be one of {', '.join(info.choices)}"
    if isinstance(value, int | float) and number:
        low, high = info.ge, info.le
        if (low is not None and value < low) or (high is not None and value > high):
            return "out-of-range", f"'{info.name}' is {value:g}, outside {low} to {high}"
    return None


def _read_case_file(
    path: FilePath, vocabulary: Vocabulary, merged: Merged, shown: str
) -> tuple[CaseFile, list[Problem]]:
    try:
        document: Document = read_document(shown, path.read_bytes())
    except OSError as error:
        problem = Problem(shown, 1, 1, "unreadable", f"cannot read the file: {error.strerror}", "check the path")
        return CaseFile(path.stem, shown), [problem]
    except RuleFileError as error:
        return CaseFile(path.stem, shown), list(error.problems)
    layer = Layer(document)
    if path.stem not in merged.rules and path.stem not in merged.disabled:
        layer.complain((), "unknown-rule", f"there is no rule {path.stem}", suggest(path.stem, merged.rules))
    if not isinstance(document.data, list):
        layer.complain((), "wrong-type", "a case file is a list of cases", "write `- name: ...` per case")
        return CaseFile(path.stem, shown), layer.problems
    cases: list[tuple[Case, int]] = []
    for index, item in enumerate(document.data):
        case = validate(layer, Case, item, (index,), f"case {index + 1}")
        if case is not None:
            before = len(layer.problems)
            _facts_problems(layer, case, index, vocabulary)
            if len(layer.problems) == before:
                cases.append((case, document.mark((index,))[0]))
    return CaseFile(path.stem, shown, tuple(cases)), layer.problems


def read_cases(
    merged: Merged, vocabulary: Vocabulary, directory: FilePath | None = None, ids: Iterable[str] | None = None
) -> tuple[list[CaseFile], list[Problem]]:
    """Read the case files of a directory (by default the shipped ones), sound cases and all problems."""
    folder = case_directory() if directory is None else directory
    wanted = None if ids is None else set(ids)
    files: list[CaseFile] = []
    problems: list[Problem] = []
    for path in sorted(folder.glob("*.yaml")) if folder.is_dir() else []:
        if wanted is None or path.stem in wanted:
            shown = f"knowledge/cases/{path.name}" if directory is None else str(path)
            file, more = _read_case_file(path, vocabulary, merged, shown)
            files.append(file)
            problems += more
    return files, problems


def facts_of(case: Case) -> frozenset[Fact]:
    """Return the facts and findings of a case."""
    facts = {
        Fact.of(str(given["fact"]), **{name: value for name, value in given.items() if name != "fact"})
        for given in case.facts
    }
    for item in case.findings:
        given = GivenFinding(finding=item) if isinstance(item, str) else item
        facts.add(Fact.of("finding", name=given.finding, severity=given.severity))
    return frozenset(facts)


def meets(expected: Expected, action: Action, resolved: ResolvedAction) -> bool:
    """Say whether an action of a firing is the one that a case expects, with the values it expects."""
    if getattr(expected, resolved.kind) != getattr(action, resolved.kind):
        return False
    values = dict(resolved.values)
    others = all(getattr(expected, name) in (None, getattr(action, name, None)) for name in ("parameter", "severity"))
    wanted: Mapping[str, Scalar] = expected.with_ if expected.to is None else {"to": expected.to}
    return others and all(_close(values.get(name), value) for name, value in wanted.items())


def _unmet(expected: Expected, rule: Rule, firings: Sequence[Firing]) -> str:
    """Say what an expectation misses in the firings; empty when it is met."""
    got: list[str] = []
    for firing in firings:
        for resolved in firing.actions:
            action: Any = rule.then[resolved.index]
            values = dict(resolved.values)
            got.append(f"{resolved.kind} {getattr(action, resolved.kind)} {values or ''}".strip())
            if meets(expected, action, resolved):
                return ""
    wish = ", ".join(
        f"{name} {value}" for name, value in expected.model_dump(by_alias=True, exclude_defaults=True).items()
    )
    return f"expected {wish}; got {'; '.join(got) or 'nothing'}"


def _close(got: Any, wanted: Any) -> bool:
    if isinstance(got, bool | str) or isinstance(wanted, bool | str) or got is None:
        return bool(got == wanted and isinstance(got, bool) == isinstance(wanted, bool))
    return bool(abs(got - wanted) <= 1e-9 * max(1.0, abs(wanted)))


def run_case(loaded: LoadedRules, engine: Engine, vocabulary: Vocabulary, file: CaseFile, index: int) -> CaseResult:
    """Run one case on its rule alone, so that no other rule's finding interferes."""
    case, line = file.cases[index]
    rule = loaded.merged.rules[file.rule][0]
    base = loaded.base.model_copy(update={"rules": [rule]})
    facts = facts_of(case)
    firings = [item for item in engine.infer(base, rule.stage, facts).firings if item.rule == rule.id]
    judge = Judge(base, vocabulary, facts)
    message = ""
    if bool(firings) != case.fires:
        deciding = judge.first_failing(rule) if case.fires else judge.tightest(rule)
        wanted, got = ("fires", "stays quiet") if case.fires else ("stays quiet", "fires")
        message = f"expected that it {wanted}, but it {got}" + (f"; {deciding}" if deciding else "")
    elif case.fires and case.expect is not None:
        message = _unmet(case.expect, rule, firings)
    boundary = judge.at_boundary(rule)
    return CaseResult(rule.id, case.name, file.file, line, not message, bool(firings), boundary, message)


def run_cases(
    loaded: LoadedRules,
    engine: Engine,
    vocabulary: Vocabulary,
    ids: Iterable[str] | None = None,
    directory: FilePath | None = None,
) -> list[CaseResult]:
    """Run the cases of all rules, or of some.

    Raises
    ------
    RuleFileError
        When a case file has problems.
    """
    files, problems = read_cases(loaded.merged, vocabulary, directory, ids)
    if problems:
        raise RuleFileError(problems)
    return [
        run_case(loaded, engine, vocabulary, file, index)
        for file in files
        if file.rule in loaded.merged.rules
        for index in range(len(file.cases))
    ]
