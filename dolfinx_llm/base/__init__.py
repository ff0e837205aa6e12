"""What all else stands on: versions of dolfinx, gathering and errors on all ranks, log, timing.

.. include:: messages.md
"""
