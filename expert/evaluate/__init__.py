"""How good terrex is: pairs with truth x distortions, against a grid of fixed configurations."""

from expert.evaluate.cases import Case, RenderedTerrain, expand, parse_variants
from expert.evaluate.grid import FixedSystem, fixed_grid
from expert.evaluate.peer import PandoraSystem
from expert.evaluate.run import RunReport, evaluate
from expert.evaluate.store import Row, Store
from expert.evaluate.systems import ExpertConfiguration
from expert.evaluate.table import Table

__all__ = [
    "Case",
    "ExpertConfiguration",
    "FixedSystem",
    "PandoraSystem",
    "RenderedTerrain",
    "Row",
    "RunReport",
    "Store",
    "Table",
    "evaluate",
    "expand",
    "fixed_grid",
    "parse_variants",
]
