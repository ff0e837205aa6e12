"""The classical discrete form of contact: displacements and multipliers, no frame, (6).

Two ways to its constraint operator Q, for comparison with the frame-augmented system (31):
node-to-segment contact (2)-(6), which prefers a side and fails the patch test, and the frame form
with v eliminated (32)-(36), which is equivalent to (31) and, with the orthonormal basis used here,
couples every constraint with every node. Only in this package sides are called master and slave.
"""

from dolfinx_llm.problem.classical.elimination import Elimination
from dolfinx_llm.problem.classical.form import ConstraintStats, constraint_stats
from dolfinx_llm.problem.classical.node_to_segment import NodeToSegment

__all__ = ["ConstraintStats", "Elimination", "NodeToSegment", "constraint_stats"]
