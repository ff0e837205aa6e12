"""What is told of a solve, per interface and side, and what in it may be doubted."""
