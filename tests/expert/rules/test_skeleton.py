from __future__ import annotations

import pytest
import yaml

from expert.rules.problem import RuleFileError
from expert.rules.skeleton import NEW_FILE, appended, next_id, rule_skeleton
from modules.catalog import operators, probes

SKELETON = rule_skeleton("COR021", "correction", "dust-on-lens", operators(), probes())


def test_the_next_id_follows_the_highest_of_its_stage_and_leaves_gaps():
    assert next_id("matching", ["MAT001", "MAT030", "COR999"]) == "MAT031"
    assert next_id("matching", []) == "MAT001"
    with pytest.raises(ValueError, match="COR999 is in use"):
        next_id("correction", ["COR999"])


@pytest.mark.parametrize(
    "text",
    [
        NEW_FILE,
        "version: 1\n",
        "version: 1\nrules:\n- id: COR001\n  name: a\n",
        "# mine\nversion: 1\n\nrules:\n    - id: COR001\n      name: a  # a note\n    # the end\n\n\n",
        "version: 1\r\nrules:\r\n  - id: COR001\r\n    name: a\r\n",
        "version: 1\nrules:\n  - id: COR001",
    ],
)
def test_an_appended_rule_leaves_the_rest_of_the_file_alone(text):
    result = appended("rig.yaml", text.encode(), SKELETON)
    assert result.startswith(text.rstrip())
    before, after = yaml.safe_load(text), yaml.safe_load(result)
    assert after["rules"][:-1] == (before.get("rules") or [])
    assert after["rules"][-1] == yaml.safe_load(SKELETON)[0]
    assert result.count("\r\n") in (0, result.count("\n"))


@pytest.mark.parametrize(
    "text",
    ["version: 1\nrules: []\n", "rules:\n  - id: COR001\nversion: 1\n", "- 1\n", "rules: [{id: COR001}]\n"],
)
def test_a_file_that_does_not_end_with_a_block_list_of_rules_is_left_alone(text):
    with pytest.raises(RuleFileError, match=r"rig\.yaml:\d+:\d+: cannot-append: .*; paste the rule by hand"):
        appended("rig.yaml", text.encode(), SKELETON)
