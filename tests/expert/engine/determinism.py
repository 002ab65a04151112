"""Print digests that are the same on every Python, for every hash seed and with both engines.

`PYTHONPATH=. python tests/expert/engine/determinism.py [DECISION.json ...]`: one digest of random programs, for every
record the digest of the canonical core that its recorded facts give. `make versions` compares them over all supported
Pythons.
"""

from __future__ import annotations

import hashlib
import json
import random
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from random_programs import STAGE, Generator, small_catalog, small_vocabulary

from expert.decision import Decision
from expert.engine import ENGINES, EngineName, make_engine
from expert.explain import rules_of
from expert.facts import vocabulary
from expert.firing import Firings
from expert.plan import Directives, settle
from expert.redecide import redecided
from expert.rules.strata import CyclicNegation
from modules.catalog import probes

PROGRAMS = 100
RECORDS = Path(__file__).parent / "recorded"


def _pairs(values: Iterable[tuple[str, Any]]) -> list[list[str]]:
    return [[name, repr(value)] for name, value in values]


def canonical(result: Firings) -> list[Any]:
    """Return firings and facts as JSON holds them, in the order they are given."""
    firings = [
        [
            firing.rule,
            [[alias, fact.template, _pairs(fact.fields)] for alias, fact in firing.bindings],
            [[action.index, action.kind, _pairs(action.values)] for action in firing.actions],
        ]
        for firing in result.firings
    ]
    return [firings, sorted(map(str, result.facts))]


def digest_of_programs(engine: EngineName, programs: int = PROGRAMS) -> str:
    """Return the digest of what random programs fire and plan."""
    words, catalog, digest = small_vocabulary(), small_catalog(), hashlib.sha256()
    for seed in range(programs):
        generator = Generator(random.Random(seed))
        rules, facts = generator.rule_base(), generator.facts()
        try:
            result = make_engine(engine, words).infer(rules, STAGE, facts)
        except CyclicNegation as error:
            digest.update(str(error).encode())
            continue
        digest.update(json.dumps(canonical(result)).encode())
        digest.update(settle(rules, STAGE, result.firings, catalog, Directives()).model_dump_json().encode())
    return digest.hexdigest()


def core_of_record(path: Path, engine: EngineName) -> str:
    """Return the digest of the core that the facts of a record give with the rules that it carries."""
    decision = Decision.from_json(path.read_text(encoding="utf-8"))
    words = vocabulary(probes().values())
    return hashlib.sha256(redecided(decision, rules_of(decision), make_engine(engine, words)).core()).hexdigest()


def main(records: list[str]) -> None:
    """Print the digests, and fail where the engines disagree."""
    for name, digests in {
        f"{PROGRAMS} programs": {digest_of_programs(engine) for engine in ENGINES},
        **{path: {core_of_record(Path(path), engine) for engine in ENGINES} for path in records},
    }.items():
        if len(digests) != 1:
            raise SystemExit(f"the engines disagree about {name}")
        print(f"{digests.pop()}  {name}")


if __name__ == "__main__":
    main(sys.argv[1:])
