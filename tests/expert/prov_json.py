"""A checker of PROV-JSON documents, after the W3C Member Submission of 24 April 2013."""

from __future__ import annotations

from typing import Any

RELATIONS = {  # the attributes that name other records; the first two must be there
    "wasGeneratedBy": ("prov:entity", "prov:activity"),
    "used": ("prov:activity", "prov:entity"),
    "wasInformedBy": ("prov:informed", "prov:informant"),
    "wasDerivedFrom": ("prov:generatedEntity", "prov:usedEntity"),
    "wasAttributedTo": ("prov:entity", "prov:agent"),
    "wasAssociatedWith": ("prov:activity", "prov:agent", "prov:plan"),
    "wasInfluencedBy": ("prov:influencee", "prov:influencer"),
}
KIND_OF_END = {
    "prov:entity": "entity", "prov:activity": "activity", "prov:informed": "activity", "prov:informant": "activity",
    "prov:generatedEntity": "entity", "prov:usedEntity": "entity", "prov:agent": "agent", "prov:plan": "entity",
}  # fmt: skip
RECORDS = ("entity", "activity", "agent")


def check_prov(document: dict[str, Any]) -> None:
    """Assert that a document has known sections, declared names, and values of the allowed forms."""
    assert set(document) <= {"prefix", *RECORDS, *RELATIONS}, set(document)
    prefixes = {*document["prefix"], "prov", "xsd", "_"}
    named = {kind: set(document.get(kind, ())) for kind in RECORDS}
    for section, records in document.items():
        if section == "prefix":
            continue
        for name, attributes in records.items():
            assert name.partition(":")[0] in prefixes, name
            for key, value in attributes.items():
                assert key.partition(":")[0] in prefixes, key
                _check_value(value)
        for attributes in records.values() if section in RELATIONS else ():
            ends = RELATIONS[section]
            assert set(ends[:2]) <= set(attributes) <= set(ends), (section, attributes)
            for end, target in attributes.items():
                known = named[KIND_OF_END[end]] if end in KIND_OF_END else set().union(*named.values())
                assert target in known, (section, end, target)


def _check_value(value: Any) -> None:
    if isinstance(value, dict):
        assert set(value) <= {"$", "type", "lang"}, value
        assert "$" in value
    elif isinstance(value, list):
        for item in value:
            _check_value(item)
    else:
        assert isinstance(value, str | int | float | bool), value
