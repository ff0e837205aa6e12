"""What you use: ``ContactProblem``, loads, and the classical methods for comparison.

.. include:: options.md
"""
