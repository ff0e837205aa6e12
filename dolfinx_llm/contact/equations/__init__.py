"""What laws ask of forces and motions, linearised: one system for each iteration."""
