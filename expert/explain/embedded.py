"""The rules inside a record: what decided, to be asked again when the rule files have changed."""

from __future__ import annotations

import base64
import binascii
import gzip
import hashlib
import zlib

from expert.decision import Decision, RulesRecord
from expert.explain.record import ExplainError
from expert.rules.load import KnownRules, canonical_json
from expert.rules.model import RuleBase

MAX_BYTES = 20_000_000  # of the rules, unpacked


def embed(rules: KnownRules) -> RulesRecord:
    """Pack rules into what a record carries."""
    packed = gzip.compress(canonical_json(rules.base).encode(), mtime=0)
    files = tuple(dict.fromkeys(file for file, _ in rules.positions.values()))
    return RulesRecord(
        files=files,
        positions=dict(sorted(rules.positions.items())),
        content=base64.b64encode(packed).decode("ascii"),
    )


def rules_of(decision: Decision) -> KnownRules:
    """Unpack the rules that a record carries.

    Raises
    ------
    ExplainError
        It carries none, they are damaged, or they are not those that its digest names.
    """
    if decision.rules is None:
        raise ExplainError("the record carries no rules; it was not made by `terrex run` or `terrex decide`")
    try:
        unpacker = zlib.decompressobj(wbits=zlib.MAX_WBITS | 16)
        text = unpacker.decompress(base64.b64decode(decision.rules.content, validate=True), MAX_BYTES)
    except (binascii.Error, zlib.error) as error:
        raise ExplainError(f"the rules in the record are damaged: {error}") from error
    found = hashlib.sha256(text).hexdigest()
    if unpacker.unconsumed_tail or found != decision.rules_digest:
        raise ExplainError(
            f"the rules in the record are not those it was decided with: {decision.rules_digest[:16]} is written, "
            f"{found[:16]} was found"
        )
    try:
        base = RuleBase.model_validate_json(text)
    except ValueError as error:
        raise ExplainError(f"this version cannot read the rules in the record: {error}") from error
    return KnownRules(base, dict(decision.rules.positions), decision.rules_digest)
