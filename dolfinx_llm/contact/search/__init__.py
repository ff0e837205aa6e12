"""One load step: the iteration, and what helps where it does not come to rest."""
