"""Where everything in a decision came from, as W3C PROV-JSON.

References
----------
T. D. Huynh et al., The PROV-JSON Serialization, W3C Member Submission, 24 April 2013.
L. Moreau, P. Missier (eds.), PROV-DM: The PROV Data Model, W3C Recommendation, 30 April 2013.
"""

from __future__ import annotations

from typing import Any

from expert.decision import Decision, FactRecord, FiringRecord
from expert.facts import Scalar
from expert.plan import NONE

Attributes = dict[str, Any]
NAMESPACES = {"prov": "http://www.w3.org/ns/prov#", "terrex": "urn:terrex:"}
PRODUCT_OF = {"disparity_px": "matching", "validity": "matching", "elevation_m": "reconstruction"}


class _Graph:
    """A PROV-JSON document that grows."""

    def __init__(self) -> None:
        self.sections: dict[str, dict[str, Attributes]] = {}

    def add(self, kind: str, name: str, **attributes: Any) -> str:
        """Add an entity, activity or agent; return its name."""
        named = {key.replace("__", ":"): value for key, value in attributes.items() if value is not None}
        self.sections.setdefault(kind, {})[name] = named
        return name

    def relate(self, kind: str, **ends: str) -> None:
        """Add a relation, once."""
        attributes = {f"prov:{key}": value for key, value in ends.items()}
        section = self.sections.setdefault(kind, {})
        if attributes not in section.values():
            section[f"_:{kind}{len(section)}"] = attributes


def as_prov(decision: Decision) -> dict[str, Any]:
    """Return the provenance of a decision: what was measured on what, which rules used it, what was run and made.

    Parameters
    ----------
    decision : Decision

    Returns
    -------
    dict
        A PROV-JSON document: images, rules, facts, findings, plans and products are entities; probes, inferences and
        operators are activities; the program is the agent.
    """
    graph = _Graph()
    agent = graph.add(
        "agent",
        "terrex:program",
        prov__type={"$": "prov:SoftwareAgent", "type": "prov:QUALIFIED_NAME"},
        **{f"terrex__{name.replace('-', '_')}": text for name, text in sorted(decision.versions.items())},
    )
    images = [
        graph.add(
            "entity",
            f"terrex:image/{side}",
            terrex__sha256=image.sha256,
            terrex__shape="x".join(map(str, image.shape)),
            terrex__dtype=image.dtype,
        )
        for side, image in (("left", decision.inputs.left), ("right", decision.inputs.right))
    ]
    rules = graph.add("entity", "terrex:rules", terrex__sha256=decision.rules_digest)
    facts = {_key(record): _fact(graph, index, record, images, agent) for index, record in enumerate(decision.facts)}
    findings = _firings(graph, decision, facts, rules, agent)
    made = _plans(graph, decision, images, agent)
    record = graph.add(
        "entity",
        f"terrex:decision/{decision.id}",
        prov__label=f"decision about {decision.pair}",
        terrex__status=decision.status,
        terrex__profile=decision.profile,
        terrex__inputs_sha256=decision.inputs_digest,
    )
    graph.relate("wasAttributedTo", entity=record, agent=agent)
    for source in (*images, rules, *facts.values(), *findings.values(), *made):
        graph.relate("wasDerivedFrom", generatedEntity=record, usedEntity=source)
    return {"prefix": {"terrex": NAMESPACES["terrex"]}, **graph.sections}


def _key(record: FactRecord) -> tuple[str, tuple[tuple[str, Scalar], ...]]:
    return record.template, tuple(record.fields.items())


def _fact(graph: _Graph, index: int, record: FactRecord, images: list[str], agent: str) -> str:
    """Add a fact, and the probe that measured it."""
    values = {
        f"terrex:{name}": f"{value} {record.units[name]}" if name in record.units else value
        for name, value in record.fields.items()
    }
    name = graph.add("entity", f"terrex:fact/{index}", prov__label=record.template, **values)
    if record.probe is None:
        graph.relate("wasAttributedTo", entity=name, agent=agent)
        return name
    probe = graph.add("activity", f"terrex:probe/{record.probe}", prov__label=record.probe)
    graph.relate("wasAssociatedWith", activity=probe, agent=agent)
    graph.relate("wasGeneratedBy", entity=name, activity=probe)
    for image in images:
        graph.relate("used", activity=probe, entity=image)
    return name


def _firings(graph: _Graph, decision: Decision, facts: dict[Any, str], rules: str, agent: str) -> dict[str, str]:
    """Add every firing as an activity, and the findings that it derived."""
    findings = {
        item.name: graph.add(
            "entity", f"terrex:finding/{item.name}", prov__label=item.sentence, terrex__severity=item.severity
        )
        for item in decision.findings
    }
    for index, firing in enumerate(decision.firings):
        name = graph.add(
            "activity",
            f"terrex:firing/{index}",
            prov__label=f"{firing.rule} {firing.name}",
            terrex__stage=firing.stage,
            terrex__because=firing.because,
        )
        graph.relate("wasAssociatedWith", activity=name, agent=agent)
        graph.relate("used", activity=name, entity=rules)
        for source in _sources(firing, facts, findings):
            graph.relate("used", activity=name, entity=source)
        for item in decision.findings:
            if firing.rule in item.rules:
                graph.relate("wasGeneratedBy", entity=findings[item.name], activity=name)
    return findings


def _sources(firing: FiringRecord, facts: dict[Any, str], findings: dict[str, str]) -> list[str]:
    found = []
    for record in firing.bindings.values():
        name = facts.get(_key(record)) or findings.get(str(record.fields.get("name")))
        if name is not None:
            found.append(name)
    return found


def _plans(graph: _Graph, decision: Decision, images: list[str], agent: str) -> list[str]:
    """Add the plans, the operators they ran, and the products."""
    made: list[str] = []
    before: list[str] = list(images)
    for stage, plan in decision.plans.items():
        name = graph.add("entity", f"terrex:plan/{stage}", prov__type={"$": "prov:Plan", "type": "prov:QUALIFIED_NAME"})
        made.append(name)
        for index, firing in enumerate(decision.firings):
            if firing.stage == stage:
                graph.relate("wasInfluencedBy", influencee=name, influencer=f"terrex:firing/{index}")
        if decision.status == "decided":
            continue
        last: str | None = None
        for step in plan.steps:
            if step.operator == NONE:
                continue
            parameters = {f"terrex:{key}": _plain(value) for key, value in step.parameters.items() if value is not None}
            ran = graph.add("activity", f"terrex:operator/{step.operator}", prov__label=step.operator, **parameters)
            graph.relate("wasAssociatedWith", activity=ran, agent=agent, plan=name)
            for source in before if last is None else ():
                graph.relate("used", activity=ran, entity=source)
            if last is not None:
                graph.relate("wasInformedBy", informed=ran, informant=last)
            last = ran
        products = [product for product in decision.products if PRODUCT_OF.get(product) == stage]
        for product in products:
            entity = graph.add("entity", f"terrex:product/{product}", terrex__sha256=decision.products[product])
            made.append(entity)
            if last is not None:
                graph.relate("wasGeneratedBy", entity=entity, activity=last)
        before = [*before, *(f"terrex:product/{product}" for product in products)]
    return made


def _plain(value: Any) -> Any:
    """Return a value that an attribute can hold."""
    return value if isinstance(value, bool | int | float | str) else str(value)
