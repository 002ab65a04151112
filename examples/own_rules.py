"""Layer a rig's own rules on the shipped ones and see the decision change.

python examples/own_rules.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from small_pair import write_small_pair

from expert import ExpertSystem, StereoPair

RULES = Path(__file__).parent / "my_rig.yaml"


def main() -> None:
    with tempfile.TemporaryDirectory() as temporary:
        folder = write_small_pair(Path(temporary) / "pair")
        pair = StereoPair.load(folder / "left.png", folder / "right.png", disparity_range_px=(0, 32))
    for rules in ([], [RULES]):
        decision = ExpertSystem(rules=rules, engine="compiled").decide(pair)
        speckles = next(step for step in decision.steps() if step.slot == "speckles")
        print(f"rules {[path.name for path in rules]}: speckles up to {speckles.parameters['max_size_px']} px")
        print(f"  set by {speckles.set_by or 'the default'}; fired: {', '.join(decision.rules_fired)}")


if __name__ == "__main__":
    main()
