"""B, L_b and g of (31) as PETSc matrices and vectors; bodies, and what holds them."""
