"""Newton's linear system, factorised or by multigrid."""
